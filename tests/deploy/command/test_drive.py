"""`deltaq drive` against a cell that `deltaq up` runs: real processes, real zenoh, real UDP."""

import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import PROGRAM, deltaq
from shared_cell import SharedStack

import deltaq_deploy.command
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol.messages import RobotState, RobotStatus

pytestmark = pytest.mark.live

SCRIPT = """\
- {duration_s: 1, mode: advisor, option: 1}
- {duration_s: 0.8, mode: coupled, move: {z_m_s: 0.05}, outputs: {gripper: on}}
- {duration_s: 1.2, mode: self-motion, move: {a1_deg_s: 10}}
- {duration_s: 0.8, mode: decoupled, frame: tool, move: {z_mm_s: 50, e2_m_s: 0.05}}
- {duration_s: 0.8, mode: joint, move: {a6_deg_s: 20}, outputs: {gripper: off}}
"""


@pytest.fixture(scope="module")
def cell(shared_stack: SharedStack) -> Path:
    return shared_stack.renewed().file


def status(cell: Path) -> RobotStatus:
    with connect(load_cell(cell), "test") as running:
        return running.status().robots["gr"]


def wait_for(cell: Path, reached: Callable[[RobotState], bool]) -> None:
    """Until a state of gr is as it shall be."""
    deadline = time.monotonic() + 300
    with connect(load_cell(cell), "test") as running:
        for state in running.states("gr"):
            if reached(state):
                return
            assert time.monotonic() < deadline, state.phase


def wait_for_phase(cell: Path, wanted: str) -> None:
    wait_for(cell, lambda state: state.phase == wanted)


def wait_for_motion(cell: Path) -> None:
    """Until A1 of gr has moved by a hundredth of a radian."""
    seen: list[float] = []

    def moved(state: RobotState) -> bool:
        seen.append(state.q[3])
        return abs(seen[-1] - seen[0]) > 0.01

    wait_for(cell, moved)


def written(folder: Path, text: str) -> str:
    file = folder / "task.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


@pytest.mark.nightly
def test_a_script_drives_every_mode_in_turn_and_reports_the_poses_of_the_hand(
    cell: Path, tmp_path: Path
) -> None:
    script = written(tmp_path, SCRIPT)
    arguments = (
        "--robot",
        "gr",
        "--script",
        script,
        "--criterion",
        "travel=1",
        "--criterion",
        "clearance=0.5",
    )
    done = deltaq("drive", *arguments, "--mode", "advisor", "--json", "--cell", str(cell))
    # the way to an option takes longer than the step, and that is told
    assert done.returncode == 1, done.stderr
    assert "option 1: energy" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["missed"] == [1]
    assert summary["legs"][0]["options"] == [{"option": 1, "reached": False}]
    legs = {leg["mode"]: leg["hands"]["tool"] for leg in summary["legs"]}
    assert list(legs) == ["advisor", "coupled", "self-motion", "decoupled", "joint"]
    # how far each goes depends on how busy the machine is: a cycle that it misses is braked, joint by joint, and that
    # takes a hand off its place by millimetres. `tests/controllers/test_modes.py` holds the amounts in virtual time
    assert legs["advisor"]["farthest_mm"] < 5
    assert legs["advisor"]["farthest_deg"] < 0.5
    assert 0.1 < legs["coupled"]["moved_mm"] < 50
    assert legs["self-motion"]["farthest_mm"] < 5
    assert legs["self-motion"]["farthest_deg"] < 0.5
    assert legs["decoupled"]["moved_mm"] > 0.1
    assert 0.1 < legs["joint"]["turned_deg"] < 20
    assert summary["gate"]["admitted"] > 0
    assert summary["outputs"] == [
        {"output": "gripper", "on": True, "error": None},
        {"output": "gripper", "on": False, "error": None},
    ]
    assert "deltaq: gripper: on" in done.stderr
    wait_for_phase(cell, "ready")


def test_an_interrupt_brings_the_robot_to_rest_and_releases_it(cell: Path, tmp_path: Path) -> None:
    script = written(tmp_path, "- {duration_s: 60, move: {a1_deg_s: -4}}\n")
    command = [PROGRAM, "drive", "--robot", "gr", "--script", script, "--json", "--cell", str(cell)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as driver:
        wait_for_motion(cell)
        driver.send_signal(signal.SIGINT)
        out, error = driver.communicate(timeout=300)
    assert driver.returncode == 0, error
    assert json.loads(out)["legs"][0]["hands"]["tool"]["farthest_mm"] > 0
    assert status(cell).lease.holder is None
    wait_for_phase(cell, "ready")


def test_a_stop_ends_the_drive_and_a_held_robot_is_not_driven(cell: Path, tmp_path: Path) -> None:
    script = written(tmp_path, "- {duration_s: 60, move: {a1_deg_s: 4}}\n")
    command = [PROGRAM, "drive", "--robot", "gr", "--script", script, "--cell", str(cell)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as driver:
        wait_for_motion(cell)
        with connect(load_cell(cell), "test") as running:
            running.stop()
        _, error = driver.communicate(timeout=300)
    assert driver.returncode == 1
    assert "gr is held: a client pressed stop" in error
    assert "`deltaq reset --robot gr`" in error
    again = deltaq("drive", "--robot", "gr", "--script", script, "--cell", str(cell))
    assert (again.returncode, "gr is held" in again.stderr) == (1, True)
    with connect(load_cell(cell), "test") as running:
        for robot in ("fr", "gr"):
            running.reset(robot)
    wait_for_phase(cell, "ready")


@pytest.mark.nightly
def test_a_lost_lease_ends_the_drive_and_shows_in_its_json(cell: Path, tmp_path: Path) -> None:
    script = written(tmp_path, "- {duration_s: 60, move: {a1_deg_s: -4}}\n")
    command = [PROGRAM, "drive", "--robot", "gr", "--script", script, "--json", "--cell", str(cell)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as driver:
        wait_for_motion(cell)
        with connect(load_cell(cell), "thief") as running, running.lease("gr", take=True):
            out, error = driver.communicate(timeout=300)
    assert driver.returncode == 1
    assert "lease_not_held" in error
    told = json.loads(out)
    assert told["error"]["code"] == "lease_not_held"
    assert "deltaq status" in told["error"]["hint"]
    assert told["legs"][0]["mode"] == "joint"
    wait_for_phase(cell, "ready")


class Terminal:
    """A terminal with `deltaq drive` in it, as a shell would start it."""

    def __init__(self, cell: Path, *options: str) -> None:
        self.keys, self._file = pty.openpty()
        self.before = termios.tcgetattr(self._file)
        # one that beginners have: lines, with echo
        assert self.before[3] & termios.ECHO
        assert self.before[3] & termios.ICANON
        command = [PROGRAM, "drive", "--robot", "gr", *options, "--json", "--cell", str(cell)]
        self.driver = subprocess.Popen(
            command, stdin=self._file, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def press(self, keys: str) -> None:
        os.write(self.keys, keys.encode())

    def hold(self, cell: Path) -> None:
        """Hold arrow up until the robot moves."""
        seen: list[float] = []

        def moves(state: RobotState) -> bool:
            self.press("\x1b[A")
            seen.append(state.q_cmd[0])
            return abs(seen[-1] - seen[0]) > 0.002

        wait_for(cell, moves)

    def ended(self) -> tuple[int, str, str]:
        """Exit status and output; the terminal is as it was, and what was typed last is in nobody's way."""
        out, error = self.driver.communicate(timeout=300)
        assert termios.tcgetattr(self._file) == self.before
        assert not select.select([self._file], [], [], 0.0)[0]
        os.close(self.keys)
        os.close(self._file)
        return self.driver.returncode, out, error


def test_q_ends_a_drive_in_motion_and_later_keys_do_not_reach_the_shell(cell: Path) -> None:
    terminal = Terminal(cell)
    terminal.hold(cell)
    terminal.press("qrm -rf\n" + "\x1b[A" * 20)
    status_, out, error = terminal.ended()
    assert status_ == 0, error
    summary = json.loads(out)
    assert [leg["mode"] for leg in summary["legs"]] == ["joint"]
    assert summary["error"] is None
    assert status(cell).lease.holder is None


@pytest.mark.nightly
def test_a_driven_robot_leads_another_while_it_is_coupled(cell: Path, tmp_path: Path) -> None:
    terminal = Terminal(cell, "--mode", "coupled", "--master", "fr", "--master-scale", "0.5")
    wait_for_phase(cell, "engaged")  # before, keys are not for the robot
    terminal.press("c")
    script = written(tmp_path, "- {duration_s: 1.5, mode: coupled, move: {z_m_s: 0.05}}\n")
    led = deltaq(
        "drive", "--robot", "fr", "--mode", "coupled", "--script", script, "--json", "--cell", str(cell)
    )
    assert led.returncode == 0, led.stderr
    terminal.press("q")
    status_, out, error = terminal.ended()
    assert status_ == 0, error
    (way,) = (leg["hands"]["tool"]["moved_mm"] for leg in json.loads(led.stdout)["legs"])
    (led_way,) = (leg["hands"]["tool"]["moved_mm"] for leg in json.loads(out)["legs"])
    assert way > 5
    # a busy machine may lose sight of the master, which uncouples it; tests/controllers/test_master.py holds the amount
    assert 0.5 < led_way < 0.6 * way


@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_ends_a_drive_and_restores_the_terminal(cell: Path, number: int) -> None:
    terminal = Terminal(cell)
    terminal.hold(cell)
    terminal.driver.send_signal(number)
    terminal.press("w" * 10)
    status_, out, error = terminal.ended()
    assert status_ == 0, error
    assert json.loads(out)["error"] is None


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--robot", "gr", "--mode", "fly"), "no mode 'fly'"),
        (("--robot", "gr", "--frame", "mars"), "no frame 'mars'"),
        (("--robot", "xx"), "no robot 'xx' in cell lab; it has fr, gr"),
        (("--robot", "fr", "--mode", "self-motion"), "self-motion needs more than 6 joints"),
        (("--robot", "gr", "--script", "missing.yaml"), "missing.yaml: cannot be read"),
        (("--robot", "gr", "--input", "wheel"), "no input 'wheel'; there are keyboard, gamepad, spacemouse"),
        (("--robot", "gr", "--input", "gamepad", "--script", "task.yaml"), "leave out --input gamepad"),
        (("--robot", "gr", "--input", "gamepad"), "no gamepad is plugged in"),
        (("--robot", "gr", "--input", "spacemouse"), "no SpaceMouse is plugged in"),
        (("--robot", "gr", "--master", "xx"), "no robot 'xx' in cell lab; it has fr, gr"),
        (("--robot", "gr", "--master", "gr"), "master gr: a robot cannot lead itself"),
        (("--robot", "gr", "--master", "fr", "--script", "task.yaml"), "a script couples no master"),
        (("--robot", "gr"), "the keyboard needs a terminal"),
        (("--robot", "fr", "--mode", "advisor"), "advisor needs a redundant robot, 'fr' is not"),
        (("--robot", "gr", "--criterion", "travel"), "--criterion takes NAME=NUMBER, got 'travel'"),
        (("--robot", "gr", "--trade-off", "travel"), "takes the names of two criteria, A,B, got 'travel'"),
        (("--robot", "gr", "--trade-off", "travel,travel"), "takes the names of two criteria"),
        (
            ("--robot", "gr", "--trade-off", "travel,travle"),
            "no criterion 'travle'; there are travel, limits",
        ),
        (("--robot", "gr", "--criterion", "travle=1"), "no criterion 'travle'; there are travel, limits"),
    ],
)
def test_wrong_usage_gives_one_line(
    cell: Path,
    arguments: tuple[str, ...],
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["deltaq", "drive", *arguments, "--cell", str(cell)])
    # as if no gamepad were plugged in, on a machine that has one
    monkeypatch.setenv("SDL_GAMECONTROLLER_IGNORE_DEVICES_EXCEPT", "0xffff/0xffff")
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(SystemExit) as ended:
            deltaq_deploy.command.main()
    error = capsys.readouterr().err
    assert ended.value.code == 2
    assert told in " ".join(error.replace("│", "").split())
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("switched", "code", "told"),
    [
        ("gripper=shut", 2, "OUTPUT=on or OUTPUT=off, got 'gripper=shut'"),
        ("griper=on", 1, "'griper' is not an output of gr; it has gripper, tool_changer"),
    ],
)
def test_an_output_that_the_command_cannot_switch_is_answered_with_those_that_it_can(
    cell: Path,
    switched: str,
    code: int,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["deltaq", "io", "--robot", "gr", switched, "--cell", str(cell)])
    with pytest.raises(SystemExit) as ended:
        deltaq_deploy.command.main()
    assert ended.value.code == code
    assert told in " ".join(capsys.readouterr().err.replace("│", "").split())


def test_only_the_lease_holder_switches_outputs_of_a_driven_robot(
    cell: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["deltaq", "io", "--robot", "gr", "gripper=on", "--cell", str(cell)])
    with connect(load_cell(cell), "a driver") as running, running.lease("gr"):
        with pytest.raises(SystemExit) as ended:
            deltaq_deploy.command.main()
        assert not running.io("gr").outputs["gripper"]
    assert ended.value.code == 1
    assert "a driver" in capsys.readouterr().err
