"""The containers of a compose document without an engine: the same commands, user, limits and read-only view.

Each has mounts and processes of its own, and no capability; the network is that of whoever starts them, as the compose
file says. What an engine does besides - images, cgroups, its own seccomp profile - is not there.
"""

import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from installed import ROOT

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
