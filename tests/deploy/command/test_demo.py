"""The demonstration as `make demo` runs it: real processes, no terminal."""

import json
import signal
import subprocess
from pathlib import Path

import pytest
from commands import PROGRAM

from deltaq_testing.private_cell import write_private_cell

pytestmark = pytest.mark.live

ARMS = ("fr", "gr")


def demo(folder: Path, duration_s: float) -> subprocess.Popen[str]:
    command = [PROGRAM, "demo", "--cell", str(write_private_cell(folder))]
    return subprocess.Popen(
        [*command, "--duration-s", str(duration_s), "--json"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def processes_of(folder: Path) -> list[str]:
    """Command lines that name the private cell."""
    lines = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(file.read_bytes().replace(b"\0", b" ").decode())
        except OSError:
            continue  # it has ended since
    return [line for line in lines if str(folder) in line]


def test_the_demonstration_moves_both_arms_reports_figures_and_leaves_no_process(
    tmp_path: Path,
) -> None:
    with demo(tmp_path, 4.0) as running:
        output, log = running.communicate(timeout=300)
    assert running.returncode == 0, log
    summary = json.loads(output)
    for arm in ARMS:
        robot = summary["robots"][arm]
        assert max(robot["travel"]) > 0.001
        assert robot["cycles"]["count"] > 30
        assert 0.0 < robot["admission_rate"] <= 1.0
    assert summary["gate"]["admitted"] > 30
    assert summary["tracking"]["angle_deg"]["final"] < 45.0
    assert processes_of(tmp_path) == []


@pytest.mark.nightly
def test_ctrl_c_ends_the_demonstration_early_with_the_robots_at_rest(tmp_path: Path) -> None:
    with demo(tmp_path, 600.0) as running:
        assert running.stderr is not None
        log = []
        for line in running.stderr:
            log.append(line)
            if "Ctrl-C ends it" in line:
                break
        running.send_signal(signal.SIGINT)
        _, rest = running.communicate(timeout=300)
    log.append(rest)
    assert "bringing the robots to rest" in rest, log
    assert "could not be asked to rest" not in rest, log
    assert processes_of(tmp_path) == []
