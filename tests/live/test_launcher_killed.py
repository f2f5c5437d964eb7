"""`kill -9` of what started a cell, while a robot moves: the robot brakes as certified, then everything ends."""

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from live_stack import MOVING_RAD_S

from deltaq_cell.cell_model import CellModel
from deltaq_testing.oracle import record_cycle_s

# tests/deploy/launch/test_launcher.py holds by day that no service outlives a launcher
pytestmark = [pytest.mark.live, pytest.mark.nightly]

PROGRAM = """
import signal, sys
from pathlib import Path
from live_stack import live_stack

with live_stack(Path(sys.argv[1]), moving=True):
    print("moving", flush=True)
    signal.pause()
"""
SUPPORT = Path(__file__).parents[1] / "support"


def descriptors_of(folder: Path) -> list[int]:
    """Descriptors of the processes whose command names the cell in this folder; they can be waited for."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder / "private.yaml") in (process / "cmdline").read_text():
                found.append(os.pidfd_open(int(process.name)))
        except (OSError, UnicodeDecodeError):
            continue  # it has ended since
    return found


def test_robots_come_to_rest_before_the_services_of_a_killed_launcher_end(tmp_path: Path) -> None:
    path = os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": path}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as launcher:
        assert launcher.stdout is not None
        assert launcher.stdout.readline() == "moving\n"
        services = descriptors_of(tmp_path)
        assert len(services) == 6
        launcher.send_signal(signal.SIGKILL)
    for service in services:
        assert select.select([service], [], [], 60)[0], "a service outlived its launcher"
        os.close(service)

    cell = CellModel.load(tmp_path / "private.yaml")
    robot, cycle_s = cell.robots["fr"], record_cycle_s(tmp_path / "fr.csv")
    columns = range(2 + robot.n, 2 + 2 * robot.n)
    setpoints = np.loadtxt(tmp_path / "fr.csv", delimiter=",", skiprows=1, usecols=columns)
    speed = np.abs(np.diff(setpoints, axis=0)).max(axis=1)  # [rad in a cycle]
    cruise = MOVING_RAD_S * cycle_s
    last = int(np.flatnonzero(speed)[-1])
    assert speed.max() > cruise
    assert last < len(speed) - 20, "it was ended before it stood"
    # a robot that is stopped dead moves at its full speed in its last cycle
    assert speed[last] < cruise / 2, "it did not brake"
