"""A launch with tokens: its console has one of its own, and its controllers show theirs."""

import json
import os
import stat
from pathlib import Path

import pytest

from deltaq_deploy.command.up import tell_of_console
from deltaq_deploy.launch.given_tokens import console_needs_token
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import ListeningSocket, Role, Service

OPERATOR, CONTROLLER = "0123456789abcdef-operator", "0123456789abcdef-controller"
TELLS = (
    "import json, os, signal\n"
    "print(json.dumps({n: v for n, v in os.environ.items() if n.startswith('DELTAQ_') and 'TOKEN' in n}), flush=True)\n"
    "print('ready: here', flush=True); signal.pause()"
)


def service(role: Role, **fields: object) -> Service:
    return Service(name=role.value, role=role, arguments=("-c", TELLS), **fields)  # type: ignore[arg-type]


CONSOLE = service(
    Role.CONSOLE, listens=(ListeningSocket("tcp", "127.0.0.1", 0, ""),), endpoint="http://127.0.0.1:7480"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for name in [name for name in os.environ if name.startswith("DELTAQ_") and "TOKEN" in name]:
        monkeypatch.delenv(name)
    return tmp_path / "deltaq"


def told(launcher: Launcher, name: str) -> dict[str, str]:
    return dict(json.loads(launcher.children[name].lines[0]))


def test_a_console_started_with_the_operator_token_gets_its_own_private_token(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DELTAQ_OPERATOR_TOKEN", OPERATOR)
    said: list[str] = []
    with Launcher([CONSOLE], lambda name, line: said.append(line)) as launcher:
        launcher.start()
        file = Path(told(launcher, "console")["DELTAQ_CONSOLE_TOKEN_FILE"])
        assert file.parent == folder
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        token = file.read_text().strip()
        assert len(token) >= 32
        opens = tell_of_console(launcher, wanted=True)
        assert said[-1] == f"the console is at http://127.0.0.1:7480/?token={token}"
        # a program's arguments are there for all users to read, and a browser's are what it is to open
        assert opens is not None
        assert token not in opens
        page = Path(opens.removeprefix("file://"))
        assert stat.S_IMODE(page.stat().st_mode) == 0o600
        assert f"http://127.0.0.1:7480/?token={token}" in page.read_text()
    assert not list(folder.glob("console-*"))


def test_token_files_of_a_killed_launch_are_replaced_without_following_links(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DELTAQ_CLIENT_TOKEN", CONTROLLER)
    folder.mkdir(mode=0o700)
    (folder / "console-0.token").symlink_to(tmp_path / "elsewhere")
    with Launcher([CONSOLE], lambda name, line: None) as launcher:
        launcher.start()
        assert launcher.console_token is not None
    assert not (tmp_path / "elsewhere").exists()


def test_a_console_with_a_given_token_or_without_role_keeps_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not console_needs_token({})
    assert not console_needs_token({"DELTAQ_OPERATOR_TOKEN": OPERATOR, "DELTAQ_CONSOLE_TOKEN": "x" * 16})
    assert console_needs_token({"DELTAQ_CLIENT_IDENTITY": "/etc/deltaq/operator-ada"})
    with Launcher([CONSOLE], lambda name, line: None) as launcher:
        launcher.start()
        assert told(launcher, "console") == {}
        assert tell_of_console(launcher, wanted=True) == "http://127.0.0.1:7480"
    assert not folder.exists()


def test_the_controllers_of_a_launch_show_the_controllers_token(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DELTAQ_OPERATOR_TOKEN", OPERATOR)
    monkeypatch.setenv("DELTAQ_CONTROLLER_TOKEN_FILE", "/nowhere/controller.token")
    services = [service(Role.LEADER), service(Role.FOLLOWER)]
    with Launcher(services, lambda name, line: None) as launcher:
        launcher.start()
        for name in ("leader", "follower"):
            assert told(launcher, name)["DELTAQ_CLIENT_TOKEN_FILE"] == "/nowhere/controller.token"
    monkeypatch.setenv("DELTAQ_CLIENT_TOKEN", "another")
    with Launcher([service(Role.LEADER)], lambda name, line: None) as launcher:
        launcher.start()
        assert "DELTAQ_CLIENT_TOKEN_FILE" not in told(launcher, "leader")
    assert not folder.exists()
