"""The commands of every container, as the compose file has them, by a user without rights in a read-only view."""

import json
import os
import re
import resource
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from installed import ROOT
from networks import why_none

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.compose import ADDRESS, USER, compose_document, real_time_document
from deltaq_deploy.launch.services import RESOURCES, cell_services, console_service
from studies.two_sites.packets import within
from studies.two_sites.sites import ip

DEPLOY = ROOT / "deploy"
SCRIPTS = {"healthy": DEPLOY / "healthy.sh", "until-all-ended": DEPLOY / "until-all-ended.sh"}
STARTS_WITHIN_S = 240.0
_RESOURCE = 24
"""Of the capabilities: to raise limits."""


def is_allowed() -> bool:
    """Whether this user may make such a view."""
    needed = ("unshare", "setpriv", "prlimit")
    command = [
        "unshare",
        "--mount",
        "--pid",
        "--fork",
        "sh",
        "-c",
        "mount -o remount,bind,ro / && setpriv --reuid 1 true",
    ]
    return (
        all(map(shutil.which, needed))
        and not subprocess.run(command, capture_output=True, check=False).returncode
    )


LIMITS = {"rtprio": resource.RLIMIT_RTPRIO, "memlock": resource.RLIMIT_MEMLOCK}


def may_be_real_time() -> bool:
    """Whether this user may let others ask for real-time priority, as an engine may."""
    return _at_most("rtprio", 20) == 20


def _python_for_all() -> list[str]:
    """Steps after which others than its owner reach the interpreter, which may lie in somebody's home."""
    base = Path(sys.base_prefix).resolve()
    closed = [folder for folder in base.parents if not folder.stat().st_mode & 0o001]
    if not closed:
        return []
    home = closed[-1]
    return [
        f"mount --bind {base} /mnt",
        f"mount -t tmpfs -o mode=0755 tmpfs {home}",
        f"mkdir -p {base}",
        f"mount --move /mnt {base}",
    ]


def _with_this_tree(mount: str) -> list[str]:
    """Steps that mount what would hide this tree, and leave it there to be read; none is written down in /run."""
    return [
        f"mount -n --bind {ROOT} /mnt",
        mount,
        f"mkdir -p {ROOT}",
        f"mount -n --move /mnt {ROOT}",
        f"mount -n -o remount,bind,ro {ROOT}",
    ]


def _at_most(name: str, wanted: int) -> int:
    """A limit, or what the system allows of it to who may not raise it."""
    hard = resource.getrlimit(LIMITS[name])[1]
    can_raise = (
        int(re.findall(r"CapEff:\s+(\w+)", Path("/proc/self/status").read_text())[0], 16) >> _RESOURCE & 1
    )
    return wanted if can_raise or hard == resource.RLIM_INFINITY else min(wanted, hard)


class Container:
    """One container that runs, and what it says."""

    def __init__(self, name: str, document: dict[str, Any], volumes: dict[str, Path]) -> None:
        self.name, self._document = name, document
        self.lines: deque[str] = deque(maxlen=200)
        self._process = subprocess.Popen(
            self._command(volumes),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=self._environment(),
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def first(self) -> int:
        """Its first process, seen from outside."""
        return self._children()[0]

    def wait(self, within_s: float = STARTS_WITHIN_S) -> int:
        """Its exit status."""
        status = self._process.wait(within_s)
        self._reader.join(10)
        return status

    def is_healthy(self) -> bool:
        """What its health check says, looked at from inside."""
        kind, program, *arguments = self._document["healthcheck"]["test"]
        assert kind == "CMD"
        if not self._children():
            return False
        inside = [
            "nsenter",
            "-t",
            str(self.first),
            "--mount",
            "--pid",
            "sh",
            str(SCRIPTS[program]),
            *arguments,
        ]
        return not subprocess.run(inside, capture_output=True, check=False).returncode

    def wait_until_healthy(self) -> None:
        """Until it is, as `service_healthy` waits."""
        end_s = time.monotonic() + STARTS_WITHIN_S
        while not self.is_healthy():
            assert self._process.poll() is None, f"{self.name} ended: {self.text()}"
            assert time.monotonic() < end_s, f"{self.name} is not healthy: {self.text()}"
            self._reader.join(0.1)

    def end(self, within_s: float = 20.0) -> int:
        """SIGTERM to the first process, as `docker stop` sends it."""
        if self._process.poll() is None:
            os.kill(self.first, 15)
        return self.wait(within_s)

    def kill(self) -> None:
        """Whatever is left of it: the kernel ends all with the first. `--kill-child` is lost with a change of user."""
        for pid in self._children():
            os.kill(pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()

    def text(self) -> str:
        """What it said last."""
        return "\n".join(self.lines)

    def _children(self) -> list[int]:
        try:
            return [
                int(pid)
                for pid in Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children")
                .read_text()
                .split()
            ]
        except OSError:  # it has ended
            return []

    def _command(self, volumes: dict[str, Path]) -> list[str]:
        document = self._document
        steps = ["mount --make-rprivate /"]
        # nothing of the host's is touched: the image's own folders lie over it
        steps += [f"mount -t tmpfs -o mode=0755 tmpfs {place}" for place in ("/run", "/var/lib")]
        steps.append(
            "mount -t tmpfs -o nosuid,nodev,noexec,mode=1777,size=64m tmpfs /dev/shm"
        )  # as engines do
        steps += _python_for_all()
        for volume in document.get("volumes", []):
            source, target, *mode = volume.split(":")
            steps.append(f"mkdir -p {target} && mount --bind {volumes[source]} {target}")
            if mode == ["ro"]:
                steps.append(f"mount -o remount,bind,ro {target}")
        steps += [f"mount -o remount,bind,ro {place}" for place in ("/run", "/var/lib")]
        for mount in document.get("tmpfs", []):
            place, _, options = mount.partition(":")
            own = f"mount -t tmpfs -o nosuid,nodev,noexec,{options} tmpfs {place}"
            steps += _with_this_tree(own) if ROOT.is_relative_to(place) else [own]
        steps.append("mount -o remount,bind,ro /")
        user, group = document["user"].split(":")
        limits = document.get("ulimits", {})
        words = ["prlimit", *(f"--{name}={_at_most(name, limits.get(name, 0))}" for name in LIMITS), "--"]
        words += ["setpriv", f"--reuid={user}", f"--regid={group}", "--clear-groups", "--no-new-privs"]
        words += ["--bounding-set=-all", "--inh-caps=-all", "--", *self._program()]
        script = " && ".join([*steps, f"exec {shlex.join(words)}"])
        return ["unshare", "--mount", "--pid", "--fork", "--mount-proc", "--kill-child", "sh", "-c", script]

    def _program(self) -> list[str]:
        words = list(self._document["command"])
        deltaq = [sys.executable, "-c", "from deltaq_deploy.command import main; main()"]
        programs = {"python": [sys.executable], "deltaq": deltaq}
        programs |= {name: ["sh", str(file)] for name, file in SCRIPTS.items()}
        found: list[str] = []
        while words and words[0] in programs:
            found += programs[words.pop(0)]
        return found + words

    def _environment(self) -> dict[str, str]:
        kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
        told = {
            name: re.sub(r"^\$\{\w+:-(.*)\}$", r"\1", value)
            for name, value in self._document.get("environment", {}).items()
        }
        image = {"PYTHONUNBUFFERED": "1", "PYTHONDONTWRITEBYTECODE": "1", "XDG_CACHE_HOME": "/tmp"}
        return kept | image | told

    def _read(self) -> None:
        assert self._process.stdout is not None  # a pipe was asked for
        with self._process.stdout as output:
            for line in output:
                self.lines.append(line.rstrip("\n"))


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
