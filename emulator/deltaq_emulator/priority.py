"""The emulated controller's priority among the processes of a machine.

A KRC has its own processor and keeps its clock whatever else runs; the emulator shares cores with everything. With
real-time priority it keeps its clock too (figures in docs/explanation/the-emulator.md). It stays below the
services: the processes that answer it must never wait for it. At 4 ms it takes an eighth of a core, since it sleeps
until the next cycle.
"""

from __future__ import annotations

import os

PRIORITY = 5
"""Priority of SCHED_FIFO: above everything ordinary, below HLI (9), SIM (10) and Robot Servers (20)."""


def ask_for_real_time() -> bool:
    """Ask for real-time priority for this process; returns whether the system allows it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    return True
