"""`deltaq krc` and the emulated controller as processes, over UDP on ports of their own."""

import json
from pathlib import Path
from typing import Any

import pytest
from commands import PROGRAM
from emulated import emulator
from ran import ran
from typer.testing import CliRunner

from deltaq_cell.load import load_cell
from deltaq_deploy.command.app import app
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_testing.private_cell import free_ports, write_private_cell

PATIENCE_S = 300.0


def rsi(*arguments: str) -> tuple[int, dict[str, Any]]:
    done = ran([PROGRAM, "krc", *arguments, "--json"], check=False)
    assert "listening on UDP 127.0.0.1:" in done.stderr
    assert "Traceback" not in done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    return done.returncode, told


@pytest.mark.service
def test_a_krc_is_sniffed_and_then_answered_with_zeros(tmp_path: Path) -> None:
    cell = write_private_cell(tmp_path)
    with emulator(cell, "gr"):
        port = str(load_cell(cell).robots["gr"].driver.port)  # type: ignore[union-attr] # it speaks RSI
        _, heard = rsi("sniff", "--address", "127.0.0.1", "--port", port, "--duration-s", "1")
        assert heard["telegrams"] > 20
        assert (heard["ipoc_step"], heard["decimals"], heard["garbled"]) == (12, 4, 0)
        assert len(heard["peers"]) == 1
        assert heard["reply"] is None
        assert heard["delay_growth"] > 20  # nobody answered
        assert "EIPos.E1" in heard["elements"]
        assert heard["unanswered"] == {}
        _, compared = rsi("sniff", "--cell", str(cell), "--robot", "gr", "--duration-s", "1")
        assert not [text for text in compared["problems"] if "load the same file" in text]
        _, answered = rsi("echo", "--cell", str(cell), "--robot", "gr", "--duration-s", "2")
        assert answered["unanswered"] == {}
        # how many come in time is the machine's affair; answered at all, the delays do not all add up
        assert answered["reply"]["median_s"] > 0
        assert answered["delay_growth"] < answered["telegrams"]


@pytest.mark.service
def test_the_file_of_another_robot_is_a_problem_and_exit_status_1(tmp_path: Path) -> None:
    cell = write_private_cell(tmp_path)
    with emulator(cell, "gr"):
        port = str(load_cell(cell).robots["gr"].driver.port)  # type: ignore[union-attr] # it speaks RSI
        status, told = rsi(
            "sniff", "--cell", str(cell), "--robot", "fr", "--port", port, "--duration-s", "0.5"
        )
        assert status == 1
        assert any(text.startswith("sends EIPos.E1") for text in told["problems"])
        status, told = rsi(
            "echo", "--cell", str(cell), "--robot", "fr", "--port", port, "--duration-s", "0.5"
        )
        assert status == 1
        assert told["reply"] is None
        assert sum(told["unanswered"].values()) > 5


@pytest.mark.long
def test_a_silent_krc_gives_exit_status_3_with_causes_to_check() -> None:
    (port,) = free_ports(1)
    status, told = rsi("sniff", "--address", "127.0.0.1", "--port", str(port), "--duration-s", "0.1")
    assert status == 3
    assert told["telegrams"] == 0
    assert any("firewall" in hint for hint in told["hints"])
    assert any(str(port) in hint for hint in told["hints"])


def test_an_address_of_another_machine_is_reported() -> None:
    result = CliRunner().invoke(app, ["krc", "sniff", "--address", "203.0.113.1", "--port", "40000"])
    assert isinstance(result.exception, ServiceUnreachableError)
    assert "cannot listen on UDP 203.0.113.1:40000" in str(result.exception)


@pytest.mark.parametrize(
    "arguments", [["sniff"], ["sniff", "--cell", "lab"], ["echo", "--cell", "lab"], ["echo"]], ids=" ".join
)
def test_a_missing_option_is_wrong_usage(arguments: list[str]) -> None:
    assert CliRunner().invoke(app, ["krc", *arguments]).exit_code == 2
