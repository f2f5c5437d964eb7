"""Real-time priorities of the services on shared cores, and how a process asks for its own.

A service nearer to the motors has the higher priority: a Robot Server before the gate, the gate before the HLI, whose
clients might keep it busy. An emulated KRC comes after the services that answer it. Controllers come last, but before
all ordinary programs.
"""

import logging
import os
from enum import IntEnum

_log = logging.getLogger(__name__)


class SchedulingPriority(IntEnum):
    """Priorities of SCHED_FIFO; greater runs first."""

    ROBOT_SERVER = 20
    SIM = 10
    HLI = 9
    EMULATOR = 5
    CONTROLLER = 4


def ask_for_real_time(priority: SchedulingPriority) -> None:
    """Ask for real-time priority for this thread, and for those that it starts later; say so if it is not given."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        _log.warning(
            "no real-time priority: the system does not allow it to this user (`deltaq doctor` says what to do)"
        )
