"""Clocks of single processes that are set while they run."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from studies.live_faults.clocks import Clocks, NoCompilerError, SettableClocks

pytestmark = pytest.mark.service

TELLS_THE_TIME = """
import sys, threading, time
for line in sys.stdin:
    began_s = time.monotonic()
    threading.Event().wait(0.05)
    time.sleep(0.05)
    print(time.time(), began_s, time.monotonic() - began_s, flush=True)
"""
"""Waits with a time-out and sleeps until a deadline: both go to the kernel as a time of a clock."""

Ask = Callable[[], tuple[float, float, float]]


@pytest.fixture
def clocks(tmp_path: Path) -> SettableClocks:
    return SettableClocks(tmp_path)


@pytest.fixture
def told(clocks: SettableClocks) -> Iterator[tuple[int, Ask]]:
    command = [*clocks.python, "-c", TELLS_THE_TIME]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:

        def ask() -> tuple[float, float, float]:
            """How far wall and monotonic clock are ahead, and how long a tenth of a second took [s]."""
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write("\n")
            process.stdin.flush()
            wall_s, monotonic_s, waited_s = map(float, process.stdout.readline().split())
            return wall_s - time.time(), monotonic_s - time.monotonic() + waited_s, waited_s

        ask()
        yield process.pid, ask
        process.kill()


def test_only_the_set_clock_leaps_and_no_wait_gets_longer(
    clocks: SettableClocks, told: tuple[int, Ask]
) -> None:
    pid, ask = told
    for set_to in (Clocks(wall_s=3600.0), Clocks(wall_s=-3600.0), Clocks(monotonic_s=600.0)):
        clocks.set(pid, set_to)
        wall_s, monotonic_s, waited_s = ask()
        assert wall_s == pytest.approx(set_to.wall_s, abs=30.0)
        assert monotonic_s == pytest.approx(set_to.monotonic_s, abs=30.0)
        assert 0.1 <= waited_s < 30.0


def test_a_wall_clock_drifts_from_when_it_is_told_to(clocks: SettableClocks, told: tuple[int, Ask]) -> None:
    pid, ask = told
    clocks.set(pid, Clocks(wall_drift_ppm=10_000_000))
    began_s = time.monotonic()
    assert ask()[0] < 10.0 * (time.monotonic() - began_s) + 0.1
    assert ask()[0] > 10.0 * 0.2 - 0.1


def test_a_process_that_is_yet_to_start_begins_with_the_clocks_that_were_said(clocks: SettableClocks) -> None:
    clocks.begin_with(Clocks(wall_s=-3600.0))
    now = subprocess.check_output([*clocks.python, "-c", "import time; print(time.time())"], text=True)
    assert float(now) - time.time() == pytest.approx(-3600.0, abs=30.0)


def test_a_process_without_a_folder_for_its_clocks_says_so_and_does_not_begin(
    clocks: SettableClocks, tmp_path: Path
) -> None:
    preload = {"LD_PRELOAD": str(tmp_path / "clocks.so")}
    done = subprocess.run(["true"], env=os.environ | preload, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "error: DELTAQ_CLOCKS: there is no folder \n")


@pytest.mark.parametrize(
    ("compiler", "message"),
    [("no-such-compiler", "no C compiler 'no-such-compiler'.*install gcc"), ("false", "^false .* failed")],
)
def test_a_compiler_that_is_missing_or_fails_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiler: str, message: str
) -> None:
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(NoCompilerError, match=message):
        SettableClocks(tmp_path)
