"""The commands of every container, as the compose file has them, by a user without rights in a read-only view."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from contained import Container, is_allowed, may_be_real_time
from networks import why_none

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.compose import ADDRESS, USER, compose_document, real_time_document
from deltaq_deploy.launch.services import RESOURCES, cell_services, console_service
from studies.two_sites.packets import within
from studies.two_sites.sites import ip

pytestmark = [
    pytest.mark.live,
    pytest.mark.nightly,
    pytest.mark.timeout(600),
    pytest.mark.skipif(
        not is_allowed() or bool(why_none()), reason="no view or network of its own is allowed here"
    ),
]
PANEL = ("127.0.0.1", 28152)
HLI = "tcp/127.0.0.1:7447"
MOVES = """
import sys
from deltaq_protocol.blocking import connect
from deltaq_protocol.messages import Phase
step = 0.001
with connect(sys.argv[1], client="outside") as cell:
    if cell.status().robots["fr"].phase is Phase.HELD:
        cell.reset("fr")  # telegrams may have been late while others started
    with cell.lease("fr") as robot:
        states = robot.states()
        start = next(states).q[0]
        while next(states).q[0] < start + 10 * step:
            robot.move([step, 0, 0, 0, 0, 0])
print("moved")
"""


@pytest.fixture(scope="module")
def network() -> Iterator[str]:
    """A network of its own: the compose file names the lab cell's ports on the host's network."""
    name = f"deltaq-{os.getpid()}-containers"
    ip("netns", "add", name)
    try:
        ip("-n", name, "link", "set", "lo", "up")
        yield name
    finally:
        ip("netns", "delete", name)


class Stack:
    """Containers that run, in the order in which compose starts them."""

    def __init__(self, folder: Path) -> None:
        self.document: dict[str, Any] = compose_document()
        for name, more in real_time_document()["services"].items():
            self.document["services"][name] |= more
        self.volumes = {name: folder / name for name in self.document["volumes"]}
        for volume in self.volumes.values():
            # as a new volume takes over owner and mode from the image
            volume.mkdir(mode=0o700)
            os.chown(volume, USER, USER)
        self.running: dict[str, Container] = {}

    def start(self, name: str) -> Container:
        document = self.document["services"][name]
        for needed, condition in document.get("depends_on", {}).items():
            if needed in self.running:
                continue
            container = self.start(needed)
            if condition["condition"] == "service_healthy":
                container.wait_until_healthy()
            else:
                assert container.wait() == 0, container.text()
        self.running[name] = Container(name, document, self.volumes)
        return self.running[name]

    def end(self) -> dict[str, int]:
        """As `docker compose down` does: those first that others do not need."""
        return {name: container.end() for name, container in reversed(self.running.items())}


@pytest.fixture
def stack(tmp_path: Path, network: str) -> Iterator[Stack]:
    tmp_path.chmod(0o755)  # a volume is not below a folder that is somebody's alone
    stack = Stack(tmp_path)
    try:
        with within(network):
            yield stack
    finally:
        for container in stack.running.values():
            container.kill()


def test_the_stack_comes_up_without_root_moves_a_robot_and_ends_in_order(stack: Stack) -> None:
    console = stack.start("console")
    hli = stack.start("hli")
    for container in (hli, console):
        container.wait_until_healthy()
    assert stack.start(ADDRESS).wait() == 0
    assert stack.running[ADDRESS].text() == "the console is at http://127.0.0.1:7480"
    for name, container in stack.running.items():
        if name == ADDRESS:
            continue
        status = Path(f"/proc/{container.first}/status").read_text()
        assert f"Uid:\t{USER}\t{USER}\t{USER}\t{USER}" in status, name
        assert "CapEff:\t0000000000000000" in status, name
        assert "CapBnd:\t0000000000000000" in status, name
        assert "NoNewPrivs:\t1" in status, name
        if may_be_real_time():
            assert not any("no real-time priority" in line for line in container.lines), container.text()
    moved = subprocess.run([sys.executable, "-c", MOVES, HLI], capture_output=True, text=True, check=False)
    assert moved.stdout == "moved\n", moved.stderr
    for name, used in used_by(stack).items():
        print(name, used)
    audit = stack.volumes["audit"] / "audit-lab.jsonl"
    assert b'"outside"' in audit.read_bytes()
    assert (audit.stat().st_uid, audit.stat().st_mode & 0o777) == (USER, 0o600)
    statuses = stack.end()
    assert set(statuses.values()) == {0}, {name: stack.running[name].text() for name in statuses}


def test_nobody_else_enters_the_sockets_folder_and_no_service_writes_to_what_it_runs_from(
    stack: Stack,
) -> None:
    folder = stack.volumes["guarded"]
    assert (folder.stat().st_uid, folder.stat().st_mode & 0o777) == (USER, 0o700)
    tries = (
        "import sys, pathlib\nfor place in sys.argv[1:]:\n    try:\n        pathlib.Path(place, 'x').write_text('x')\n"
        "        print('wrote', place)\n    except OSError:\n        pass"
    )
    places = [
        "/",
        "/usr",
        "/run",
        "/run/deltaq",
        "/var/lib",
        str(Path(sys.prefix)),
        str(Path(__file__).parent),
        "/tmp",
    ]
    document = stack.document["services"]["sim"] | {"command": ["python", "-c", tries, *places]}
    container = Container("writes", document, stack.volumes)
    container.wait()
    assert list(container.lines) == ["wrote /run/deltaq", "wrote /tmp"]
    stranger = ["setpriv", "--reuid=12345", "--clear-groups", "ls", str(folder)]
    assert subprocess.run(stranger, capture_output=True, check=False).returncode


def test_a_robot_server_that_is_killed_in_its_container_leaves_behind_what_brakes_its_robot(
    stack: Stack,
) -> None:
    server = stack.start("robot-server-fr")
    server.wait_until_healthy()
    stack.start("emulator-fr").wait_until_healthy()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as panel:
        panel.settimeout(300)
        panel.sendto(b'{"op": "await", "state": "RSI running", "cycles": 100, "within_s": 20}', PANEL)
        assert json.loads(panel.recv(65536))["ok"]
    (python,) = Path(f"/proc/{server.first}/task/{server.first}/children").read_text().split()
    (beside,) = Path(f"/proc/{python}/task/{python}/children").read_text().split()
    os.kill(int(python), signal.SIGKILL)
    assert server.wait(300) == 128 + signal.SIGKILL
    assert not Path(f"/proc/{beside}").exists()
    assert any("the Robot Server has died: its robot was braked" in line for line in server.lines), (
        server.text()
    )


def used_by(stack: Stack) -> dict[str, dict[str, float]]:
    """What each container uses, which is less than it may: memory and files in memory [MiB], processes and threads."""
    cell = load_cell("lab")
    services = cell_services(cell, "lab")
    roles = {service.name: service.role for service in (*services, console_service(cell, "lab", services))}
    used = {}
    for name, container in stack.running.items():
        if name not in roles:
            continue
        look = "cat /proc/[0-9]*/status; du -smx /tmp"
        inside = ["nsenter", "-t", str(container.first), "--pid", "--mount", "sh", "-c", look]
        processes = subprocess.run(inside, capture_output=True, text=True, check=False).stdout
        memory_mb = sum(int(kb) for kb in re.findall(r"VmRSS:\s+(\d+)", processes)) / 1024
        tasks = sum(int(count) for count in re.findall(r"Threads:\s+(\d+)", processes))
        files_mb = int(processes.splitlines()[-1].split()[0])
        resources = RESOURCES[roles[name]]
        assert memory_mb + files_mb < resources.memory_mb, name
        assert tasks < resources.tasks, name
        used[name] = {"memory_mb": round(memory_mb), "tasks": tasks, "files_mb": files_mb}
    return used
