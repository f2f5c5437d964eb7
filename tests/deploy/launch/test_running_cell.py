"""The command against a cell that `deltaq up` runs: real processes, real zenoh, real UDP."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from commands import PROGRAM, deltaq

from deltaq_testing.private_cell import write_private_cell

pytestmark = pytest.mark.live

SERVICES = {"robot-server-fr", "robot-server-gr", "emulator-fr", "emulator-gr", "sim", "hli", "console"}


@dataclass
class RunningCell:
    file: Path
    launcher: subprocess.Popen[str]
    lines: list[str]

    def deltaq(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return deltaq(*arguments, "--cell", str(self.file))

    def read_until(self, text: str) -> str:
        """The launcher's next line that contains `text`."""
        assert self.launcher.stdout is not None
        for line in self.launcher.stdout:
            self.lines.append(line)
            if text in line:
                return line
        pytest.fail(f"the launcher ended without a line with {text!r}; it said\n{''.join(self.lines)}")

    def children(self) -> list[int]:
        """Process ids of the services, without the warden that ends them if the launcher is killed."""
        threads = Path(f"/proc/{self.launcher.pid}/task").iterdir()
        children = [int(pid) for thread in threads for pid in (thread / "children").read_text().split()]
        return [pid for pid in children if b"warden" not in Path(f"/proc/{pid}/cmdline").read_bytes()]


def start(file: Path, *arguments: str) -> RunningCell:
    command = [PROGRAM, "up", "--cell", str(file), *arguments]
    launcher = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return RunningCell(file, launcher, [])


def finish(cell: RunningCell) -> int:
    cell.launcher.send_signal(signal.SIGINT)
    try:
        rest, _ = cell.launcher.communicate(timeout=300)
    except subprocess.TimeoutExpired:
        cell.launcher.kill()
        cell.launcher.communicate()
        raise
    cell.lines.append(rest)
    return cell.launcher.returncode


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningCell]:
    running = start(write_private_cell(tmp_path_factory.mktemp("cell")))
    try:
        running.read_until("cell lab is up")
        wait_for_phases(running, {"fr": "ready", "gr": "ready"})
        yield running
    finally:
        if running.launcher.poll() is None:
            finish(running)


def phases(cell: RunningCell) -> dict[str, str]:
    done = cell.deltaq("status", "--json")
    assert done.returncode == 0, done.stderr
    return {name: robot["phase"] for name, robot in json.loads(done.stdout)["robots"].items()}


def wait_for_phases(cell: RunningCell, wanted: dict[str, str]) -> None:
    deadline = time.monotonic() + 300
    while (found := phases(cell)) != wanted:
        assert time.monotonic() < deadline, found


def test_every_service_of_a_running_cell_is_healthy(cell: RunningCell) -> None:
    deadline = time.monotonic() + 300
    while told := json.loads(cell.deltaq("status", "--json").stdout)["lagging"]:
        assert time.monotonic() < deadline, told
    done = cell.deltaq("status", "--service", "robot-server-fr", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["healthy"] is True


def test_services_nearer_to_the_motors_have_higher_priority_if_permitted(cell: RunningCell) -> None:
    priorities: dict[str, set[int]] = {}
    for pid in cell.children():
        command = Path(f"/proc/{pid}/cmdline").read_text()
        module = next(word for word in command.split("\0") if "deltaq_" in word)
        carrying = [pid, *threads_named(pid, "rx-"), *threads_named(pid, "tx-")]
        priorities.setdefault(module, set()).update(os.sched_getparam(t).sched_priority for t in carrying)
    modules = (
        "deltaq_services.robot_server",
        "deltaq_services.sim",
        "deltaq_services.hli",
        "deltaq_emulator",
    )
    told = [priorities[module] for module in modules]
    if any("no real-time priority" in line for line in cell.lines):
        assert told == [{0}, {0}, {0}, {0}]
    else:
        assert [len(each) for each in told] == [1, 1, 1, 1]
        assert max(told[0]) > max(told[1]) > max(told[2]) > max(told[3]) > 0


def threads_named(pid: int, start: str) -> list[int]:
    """Threads of a process by the beginning of their name; zenoh's that carry messages are rx-... and tx-..."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(task.name) for task in tasks if (task / "comm").read_text().startswith(start)]


def test_status_shows_the_phase_of_each_robot(cell: RunningCell) -> None:
    done = cell.deltaq("status")
    assert done.returncode == 0
    assert re.search(r"fr .* ready", done.stdout)
    assert re.search(r"gr .* ready", done.stdout)


def test_status_watch_repeats_status_the_requested_number_of_times(cell: RunningCell) -> None:
    done = cell.deltaq("status", "--watch", "--count", "3", "--interval-s", "0.1", "--json")
    looks = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(looks) == 3
    assert looks[0]["robots"]["fr"]["cycle"] < looks[2]["robots"]["fr"]["cycle"]
    assert re.search(r"fr .* ready", cell.deltaq("status", "--watch", "--count", "1").stdout)


def test_states_come_once_a_cycle(cell: RunningCell) -> None:
    measured = json.loads(cell.deltaq("topic", "hz", "--duration-s", "2", "--json").stdout)
    rate = measured["topics"]["deltaq/lab/fr/state"]
    assert rate["rate_hz"] == pytest.approx(1 / measured["cycle_s"], rel=0.1)


def test_echo_prints_the_requested_number_of_messages_one_object_a_line(cell: RunningCell) -> None:
    done = cell.deltaq("topic", "echo", "state", "--robot", "gr", "--count", "3")
    states = [json.loads(line) for line in done.stdout.splitlines()]
    assert [state["robot"] for state in states] == ["gr", "gr", "gr"]
    assert states[0]["cycle"] < states[1]["cycle"] < states[2]["cycle"]


def test_a_stop_holds_every_robot_until_each_is_reset(cell: RunningCell) -> None:
    assert cell.deltaq("stop", "--json").returncode == 0
    wait_for_phases(cell, {"fr": "held", "gr": "held"})
    for robot in ("fr", "gr"):
        assert cell.deltaq("reset", "--robot", robot).returncode == 0
    wait_for_phases(cell, {"fr": "ready", "gr": "ready"})


def test_a_dry_run_gives_the_verdict_of_the_gate_without_motion(cell: RunningCell) -> None:
    done = cell.deltaq("dry-run", "--robot", "fr", "--dq", "1e-5,0,0,0,0,0", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["outcome"] == "admitted"
    too_much = cell.deltaq("dry-run", "--robot", "fr", "--dq", "-1,0,0,0,0,0")
    assert too_much.returncode == 1
    assert re.search(r"scaled|held", too_much.stdout)
    assert "acceleration_limit" in too_much.stdout
    short = cell.deltaq("dry-run", "--robot", "fr", "--dq", "1,2")
    assert short.returncode != 0
    assert "dq has 2 elements, fr has 6 joints" in short.stderr
    wait_for_phases(cell, {"fr": "ready", "gr": "ready"})


def test_outputs_are_set_and_shown_and_refused_to_others_than_the_lease_holder(cell: RunningCell) -> None:
    assert cell.deltaq("io", "--robot", "gr", "gripper=on").returncode == 0
    deadline = time.monotonic() + 300
    while not json.loads((told := cell.deltaq("io", "--robot", "gr", "--json")).stdout)["outputs"]["gripper"]:
        assert time.monotonic() < deadline, told
    assert "output gripper: on\noutput tool_changer: off\ninput " in cell.deltaq("io", "--robot", "gr").stdout
    unknown = cell.deltaq("io", "--robot", "gr", "horn=on")
    assert (unknown.returncode, unknown.stdout) == (1, "")
    assert "'horn' is not an output of gr; it has gripper, tool_changer" in unknown.stderr
    command = [PROGRAM, "lease", "--robot", "gr", "--take", "--json", "--cell", str(cell.file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline()
        refused = cell.deltaq("io", "--robot", "gr", "gripper=off")
        holder.send_signal(signal.SIGINT)
    assert refused.returncode == 1
    assert "deltaq lease" in refused.stderr, "who holds it"
    assert json.loads(cell.deltaq("io", "--robot", "gr", "--json").stdout)["outputs"]["gripper"]
    assert cell.deltaq("io", "--robot", "gr", "gripper=off").returncode == 0


def test_a_contact_is_allowed_shown_and_forbidden_again(cell: RunningCell) -> None:
    assert cell.deltaq("contact", "gripper_on_valves").returncode == 0
    wait_for_contacts(cell, {"gripper_on_valves": True, "sensor_on_plant": False})
    assert cell.deltaq("contact", "gripper_on_valves", "--forbid").returncode == 0
    wait_for_contacts(cell, {"gripper_on_valves": False, "sensor_on_plant": False})
    unknown = cell.deltaq("contact", "handshake")
    assert unknown.returncode != 0
    assert "no contact 'handshake'; it has gripper_on_valves" in unknown.stderr


def wait_for_contacts(cell: RunningCell, wanted: dict[str, bool]) -> None:
    deadline = time.monotonic() + 300
    while (found := json.loads(cell.deltaq("contact", "--json").stdout)["contacts"]) != wanted:
        assert time.monotonic() < deadline, found


def test_a_held_lease_is_shown_and_can_be_revoked(cell: RunningCell) -> None:
    command = [PROGRAM, "lease", "--robot", "fr", "--take", "--json", "--cell", str(cell.file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert json.loads(holder.stdout.readline())["holder"] == "deltaq lease"
        assert json.loads(cell.deltaq("lease", "--robot", "fr", "--json").stdout)["holder"] == "deltaq lease"
        holder.send_signal(signal.SIGINT)
        assert holder.wait(300) == 0
    released = cell.deltaq("lease", "--robot", "fr", "--release", "--json")
    assert json.loads(released.stdout)["holder"] is None


def test_a_cell_cannot_be_started_twice(cell: RunningCell) -> None:
    done = cell.deltaq("up")
    assert done.returncode == 1
    assert re.search(r"robot-server-fr cannot listen on udp .*`robots.fr.driver.port`", done.stderr)


def test_the_wrong_cell_at_an_address_is_named(cell: RunningCell, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(f"extends: {cell.file}\ncell: other\n", encoding="utf-8")
    done = deltaq("status", "--cell", str(other))
    assert done.returncode == 2
    assert "serves cell lab, not other" in done.stderr


def test_a_dead_service_is_named_and_restarted_and_no_process_remains(
    cell: RunningCell,
) -> None:
    """The last of this cell."""
    children = cell.children()
    assert len(children) == len(SERVICES)
    (sim,) = [pid for pid in children if b"deltaq_services.sim" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(sim, signal.SIGKILL)
    assert "sim was ended by SIGKILL; the others continue" in cell.read_until("SIGKILL")
    again = start(cell.file, "--only", "sim")
    try:
        again.read_until("cell lab is up: sim")
        assert cell.deltaq("status", "--service", "sim").returncode == 0
    finally:
        assert finish(again) == 0
    assert finish(cell) == 1  # a service died: that is told in the exit status too
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
