"""The first process of a Robot Server's container: what it leaves behind, and when it ends."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from installed import ROOT

SCRIPT = ROOT / "deploy" / "until-all-ended.sh"
OWN_PROCESSES = ["unshare", "--pid", "--fork", "--mount-proc", "--kill-child"]
LEAVES_ONE = """
import os, signal, subprocess, sys
left = subprocess.Popen([sys.executable, "-c", sys.argv[1]], start_new_session=True)
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
print("ready", flush=True)
signal.sigwait({signal.SIGTERM})  # also one that came since then
os._exit(7)
"""
BRAKES = """
import signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("left", flush=True)
sys.stdin.read(1)
end = time.monotonic() + 0.3
while time.monotonic() < end:
    time.sleep(0.01)
print("robot at rest", flush=True)
"""


def _is_allowed() -> bool:
    return (
        shutil.which("unshare") is not None
        and not subprocess.run([*OWN_PROCESSES, "true"], capture_output=True, check=False).returncode
    )


pytestmark = pytest.mark.skipif(not _is_allowed(), reason="no process namespace is allowed here")


@contextmanager
def contained(code: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [*OWN_PROCESSES, "sh", str(SCRIPT), sys.executable, "-c", code, *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def first_process(of: subprocess.Popen[str]) -> int:
    (child,) = Path(f"/proc/{of.pid}/task/{of.pid}/children").read_text().split()
    return int(child)


def command_in(container: int) -> int:
    return int(Path(f"/proc/{container}/task/{container}/children").read_text().split()[0])


@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, 128 + 9), (signal.SIGTERM, 7)])
def test_leftover_children_of_a_service_end_and_the_status_is_the_services(
    number: signal.Signals, status: int
) -> None:
    with contained(LEAVES_ONE, BRAKES) as process:
        assert process.stdout is not None
        assert {process.stdout.readline(), process.stdout.readline()} == {"ready\n", "left\n"}
        os.kill(command_in(first_process(process)), number)
        assert process.communicate("", timeout=300)[0] == "robot at rest\n"
        assert process.returncode == status


def test_sigterm_is_forwarded_to_the_service() -> None:
    with contained(
        "import signal, os\nsignal.pthread_sigmask(signal.SIG_BLOCK, {15})\nprint('ready', flush=True)\n"
        "signal.sigwait({15})\nos._exit(5)"
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        os.kill(first_process(process), signal.SIGTERM)
        assert process.wait(300) == 5


def test_without_the_wrapper_the_end_of_the_first_process_kills_all_others() -> None:
    command = [*OWN_PROCESSES, sys.executable, "-c", LEAVES_ONE, BRAKES]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert {process.stdout.readline(), process.stdout.readline()} == {"ready\n", "left\n"}
        os.kill(first_process(process), signal.SIGTERM)
        assert process.communicate("", timeout=300)[0] == ""
