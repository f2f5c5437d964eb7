"""A soak: its report, however it ends."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deltaq_deploy.command.app import app
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.catalogue import CATALOGUE
from deltaq_testing.live import applies_live
from deltaq_testing.soak import SoakReport, SoakRound

COMMAND = "from deltaq_deploy.command import main; main()"


@pytest.mark.nightly
@pytest.mark.live
def test_ctrl_c_ends_a_soak_with_the_report_so_far_and_no_process(tmp_path: Path) -> None:
    words = [
        "bench",
        "soak",
        "--hours",
        "1",
        "--cell",
        "lab",
        "--seed",
        "3",
        "--output",
        str(tmp_path / "made"),
    ]
    with subprocess.Popen(
        [sys.executable, "-c", COMMAND, *words],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # for the mover, whose own line is no part of the report
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as soak:
        assert soak.stdout is not None
        first = next(line for line in soak.stdout if " s  " in line)
        os.killpg(soak.pid, signal.SIGINT)
        rest = soak.stdout.read()
        status = soak.wait()
    assert status == 0, rest
    assert first.endswith(": good\n")
    report = json.loads((tmp_path / "made" / "soak.json").read_text())
    assert report["interrupted"] is True
    (one, *_) = report["rounds"]
    assert one["good"]
    assert one["fault"] in first
    sample = report["samples"][0]
    assert {"hli", "sim", "robot-server-fr", "robot-server-gr"} <= set(sample["memory_mb"])
    assert min(sample["memory_mb"].values()) > 5
    assert any(sample["latency_ms"] for sample in report["samples"])
    assert (tmp_path / "made" / "soak.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ProcessLookupError):
        os.killpg(soak.pid, 0)


def round_of(good: bool) -> SoakRound:
    return SoakRound(
        time_s=0, fault="sim-dead", at_s=1, for_s=1, recovered=good, clear="", limits="", good=good
    )


def test_a_soak_is_good_if_it_has_rounds_and_all_are_good() -> None:
    def of(*rounds: SoakRound) -> bool:
        return SoakReport(cell="lab", robot="fr", seed=0, asked_s=1, rounds=list(rounds)).good

    assert of(round_of(True))
    assert not of(round_of(True), round_of(False))
    assert not of()


def test_a_soak_draws_only_faults_that_apply_to_a_running_cell() -> None:
    names = {row.name for row in CATALOGUE if applies_live(row)}
    assert {
        "operator-stop",
        "hli-dead",
        "sim-frozen",
        "robot-server-dead",
        "krc-silent",
        "krc-digits",
    } <= names
    assert not names & {
        "controller-dead",
        "hli-sim-cut",
        "hli-clock-forward",
        "recorder-dead",
        "krc-port-zero",
    }


def test_an_unwritable_folder_is_refused_before_the_soak(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(
        app, ["bench", "soak", "--hours", "1", "--output", str(tmp_path / "file" / "below")]
    )
    assert isinstance(result.exception, DeltaqError)
    assert "is no folder for reports: Not a directory" in str(result.exception)
