"""Tokens from files and variables, and that a console started with a bad one says which, without showing it."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest
from guarded_peer import guarded_peer
from ran import ran
from small_cell import small_cell, told, tool_pose

from deltaq_cell.description import CellDescription
from deltaq_protocol import connect
from deltaq_protocol.errors import DeltaqError, RefusedError
from deltaq_protocol.given_token import GivenTokenError, given_token
from deltaq_services.console.settings import Settings
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.shell import Hli

DELTAQ = str(Path(sys.executable).with_name("deltaq"))
SECRET = "0123456789abcdef-secret"


def secret(folder: Path, text: bytes, mode: int = 0o600) -> str:
    file = folder / "console.token"
    file.write_bytes(text)
    file.chmod(mode)
    return str(file)


@pytest.mark.parametrize(
    ("text", "mode", "said"),
    [
        (SECRET.encode(), 0o644, "has mode 0644"),
        (b" \n", 0o600, "holds no text"),
        (b"\xff\xfe", 0o600, "holds no text"),
    ],
)
def test_an_invalid_secret_file_is_refused_without_showing_it(
    tmp_path: Path, text: bytes, mode: int, said: str
) -> None:
    with pytest.raises(GivenTokenError, match=f"DELTAQ_CONSOLE_TOKEN_FILE: .*{said}") as refused:
        given_token("DELTAQ_CONSOLE_TOKEN", {"DELTAQ_CONSOLE_TOKEN_FILE": secret(tmp_path, text, mode)})
    assert SECRET not in str(refused.value)


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(GivenTokenError, match="/nowhere cannot be read"):
        given_token("DELTAQ_CONSOLE_TOKEN", {"DELTAQ_CONSOLE_TOKEN_FILE": "/nowhere"})


def test_the_file_precedes_the_variable_and_an_empty_value_is_no_token(tmp_path: Path) -> None:
    environment = {
        "DELTAQ_CONSOLE_TOKEN": "other",
        "DELTAQ_CONSOLE_TOKEN_FILE": secret(tmp_path, SECRET.encode() + b"\n"),
    }
    assert given_token("DELTAQ_CONSOLE_TOKEN", environment) == SECRET
    assert given_token("DELTAQ_CONSOLE_TOKEN", {"DELTAQ_CONSOLE_TOKEN": "other"}) == "other"
    assert given_token("DELTAQ_CONSOLE_TOKEN", {"DELTAQ_CONSOLE_TOKEN": ""}) is None


@pytest.mark.long
def test_a_console_refuses_a_token_file_readable_by_others(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "deltaq_services.console", "--cell", "lab"]
    environment = os.environ | {"DELTAQ_CONSOLE_TOKEN_FILE": secret(tmp_path, SECRET.encode(), 0o644)}
    done = ran(command, env=environment, check=False)
    assert done.returncode == 2
    assert "DELTAQ_CONSOLE_TOKEN_FILE" in done.stderr
    assert SECRET not in done.stdout + done.stderr


def test_settings_do_not_show_their_tokens() -> None:
    shown = repr(Settings("lab", True, "127.0.0.1", 7480, SECRET, SECRET))
    assert SECRET not in shown
    assert "7480" in shown


async def test_clients_and_commands_read_their_token_from_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = tmp_path / "operator.token"
    operator.write_text(SECRET)
    operator.chmod(0o600)
    controller = secret(tmp_path, b"0123456789abcdef-controller")
    description = small_cell()
    roles = ClientRoles(SECRET, "0123456789abcdef-controller")
    async with guarded_peer(description) as peer, Hli(description, told(description), tool_pose, roles):
        await peer.turn("fr")
        async with connect(description.hli) as cell:
            with pytest.raises(RefusedError, match="DELTAQ_CLIENT_TOKEN_FILE"):
                async with cell.lease("fr"):
                    pass
        with pytest.raises(subprocess.CalledProcessError) as refused:
            await asyncio.to_thread(reset, description)
        assert b"DELTAQ_OPERATOR_TOKEN" in refused.value.stderr
        monkeypatch.setenv("DELTAQ_CLIENT_TOKEN_FILE", controller)
        monkeypatch.setenv("DELTAQ_OPERATOR_TOKEN_FILE", str(operator))
        async with connect(description.hli) as cell, cell.lease("fr"):
            pass
        await asyncio.to_thread(reset, description)


@pytest.mark.by_day(1)
@pytest.mark.parametrize(
    "names", ["DELTAQ_CLIENT_TOKEN_FILE", "DELTAQ_OPERATOR_TOKEN_FILE", "DELTAQ_CLIENT_IDENTITY"]
)
async def test_a_stop_works_without_the_secret(names: str, monkeypatch: pytest.MonkeyPatch) -> None:
    description = small_cell()
    monkeypatch.setenv(names, "/nowhere")
    async with guarded_peer(description) as peer, Hli(description, told(description), tool_pose):
        await peer.turn("fr")
        await asyncio.to_thread(command, "stop", description)
        if names.startswith("DELTAQ_CLIENT"):
            async with connect(description.hli) as cell:
                with pytest.raises(DeltaqError, match="/nowhere"):
                    async with cell.lease("fr"):
                        pass
        else:
            with pytest.raises(subprocess.CalledProcessError):
                await asyncio.to_thread(reset, description)


def command(verb: str, description: CellDescription, *arguments: str) -> None:
    subprocess.run([DELTAQ, verb, "--url", description.hli, *arguments], check=True, capture_output=True)


def reset(description: CellDescription) -> None:
    command("reset", description, "--robot", "fr")
