"""Real-time priorities of the services on shared cores, their processors, and how a process asks for its own.

A service nearer to the motors has the higher priority: a Robot Server before the gate, the gate before the HLI, whose
clients might keep it busy. An emulated KRC comes after the services that answer it. Controllers come last, but before
all ordinary programs.
"""

import contextlib
import logging
import os
from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path

_log = logging.getLogger(__name__)


class SchedulingPriority(IntEnum):
    """Priorities of SCHED_FIFO; greater runs first."""

    ROBOT_SERVER = 20
    SIM = 10
    HLI = 9
    EMULATOR = 5
    CONTROLLER = 4


SIM_PLACE = 0
"""Place of the gate when a cell's processes are dealt out to the processors; consecutive places share none."""


def place_of_robot(robots: Iterable[str], robot: str) -> int:
    """Place of a robot's Robot Server, and of the controller that drives it, among all robots of the cell.

    The HLI has no place: its threads read many clients, and one that is flooded must not keep the others waiting.
    """
    return SIM_PLACE + 1 + list(robots).index(robot)


def ask_for_real_time(priority: SchedulingPriority, place: int | None = None) -> None:
    """Ask for real-time priority for this thread, and for those that it starts later; say so if it is not given.

    Args:
        priority: of the process.
        place: with the priority it keeps to the processor of this place; None for any processor.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        _log.warning(
            "no real-time priority: the system does not allow it to this user (`deltaq doctor` says what to do)"
        )
    else:
        if place is not None:
            keep_to_one_processor(place)


def keep_to_one_processor(place: int) -> None:
    """Keep all threads of this process on one of its processors.

    The kernel moves threads of real-time priority to whichever processor is free, and their caches stay behind. On a
    busy machine that costs up to a fifth of a cycle's processor time.

    Args:
        place: consecutive places are on different processors, where there are several.
    """
    before = sorted(os.sched_getaffinity(0))
    give_processors({before[place % len(before)]})


def give_processors(processors: set[int]) -> None:
    """Let all threads of this process run on these processors."""
    for entry in Path("/proc/self/task").iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            os.sched_setaffinity(int(entry.name), processors)
