"""From a key press to the robot's motion, over real processes: `python -m studies.press_to_motion`.

A terminal drives a joint of an emulated robot by taps. A client that only watches takes the times: of the first
setpoint that differs, and of the first measured configuration that does.
"""

import argparse
import json
import os
import pty
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.program import run_program
from deltaq_protocol.blocking import BlockingCell
from deltaq_testing.live import live_cell

_UP, _DOWN = b"\x1b[A", b"\x1b[B"
_MOVED_RAD = 1e-4
"""A measured motion; the KRC's angles have steps of a thousandth of a degree, a sixth of it."""
_STILL_S = 1.5
"""From a press until the tap and its brake have ended, and the next may come [s]."""


@contextmanager
def _driven(cell: Path, robot: str) -> Iterator[int]:
    """The terminal of a `deltaq drive` in mode `joint`, to write keys to; the drive ends with the block."""
    keys, terminal = pty.openpty()
    program = [sys.executable, "-c", "from deltaq_deploy.command import main; main()"]
    command = [*program, "drive", "--cell", str(cell), "--robot", robot]
    with subprocess.Popen(
        [*command, "--mode", "joint", "--json"], stdin=terminal, stdout=subprocess.DEVNULL
    ) as drive:
        try:
            yield keys
        finally:
            os.write(keys, b"q")
            drive.wait()
            os.close(keys)
            os.close(terminal)


def _tap(running: BlockingCell, robot: str, keys: int, key: bytes) -> tuple[float, float]:
    """Time from a press to the first setpoint that moves, and to the first measured motion [s]."""
    states = running.states(robot)
    rest, setpoint_s = next(states), None
    os.write(keys, key)
    pressed_s = time.monotonic()
    for state in states:
        passed_s = time.monotonic() - pressed_s
        if setpoint_s is None and state.q_cmd != rest.q_cmd:
            setpoint_s = passed_s
        if np.abs(np.subtract(state.q, rest.q)).max() > _MOVED_RAD:
            return passed_s if setpoint_s is None else setpoint_s, passed_s
    raise AssertionError("states never end")


def measure(cell: str, robot: str, presses: int, seed: int) -> dict[str, object]:
    """The figures of so many taps [ms]."""
    pauses = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder, live_cell(Path(folder), cell, robot):
        (file,) = Path(folder).glob("*.yaml")
        with _driven(file, robot) as keys, connect(load_cell(file), "watch") as running:
            os.write(keys, _UP)  # the first comes before the drive has its lease, or while it compiles
            next(state for state in running.states(robot) if any(state.q_cmd) and state.phase == "engaged")
            cycle_s, taps = load_cell(file).cycle_s, []
            for number in range(presses):  # to and fro, so that no tap meets a limit
                time.sleep(_STILL_S + pauses.random() * cycle_s)
                taps.append(_tap(running, robot, keys, (_DOWN, _UP)[number % 2]))
    shares = (50, 99)
    setpoint_ms, measured_ms = (
        np.percentile(1e3 * np.array(column), shares) for column in zip(*taps, strict=True)
    )
    return {
        "cell": cell,
        "presses": presses,
        "setpoint_ms": {f"p{share}": round(at, 1) for share, at in zip(shares, setpoint_ms, strict=True)},
        "measured_ms": {f"p{share}": round(at, 1) for share, at in zip(shares, measured_ms, strict=True)},
    }


def main() -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cell", default="lab", help="cell to start (default: %(default)s)")
    parser.add_argument("--robot", default="gr", help="robot to drive (default: %(default)s)")
    parser.add_argument("--presses", type=int, default=100, help="number of taps (default: %(default)s)")
    parser.add_argument(
        "--seed", type=int, default=0, help="of the pauses between them (default: %(default)s)"
    )
    given = parser.parse_args()
    print(json.dumps(measure(given.cell, given.robot, given.presses, given.seed)))


if __name__ == "__main__":
    run_program(main, "studies.press_to_motion")
