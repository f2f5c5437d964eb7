"""The emulated controller's place among the processes of a machine.

A KRC has a processor of its own and keeps its clock whatever else runs; here it shares cores with everything. With
real-time priority it keeps it too (figures in docs/explanation/the-emulator.md). It stays below the services: what
answers it must never wait for it. At 4 ms it takes an eighth of a core, since it sleeps until the next cycle.
"""

from __future__ import annotations

import os

PRIORITY = 5
"""Of SCHED_FIFO: above everything ordinary, below HLI (9), SIM (10) and Robot Servers (20)."""


def ask_for_real_time() -> bool:
    """Real-time priority for this process, where the system allows it; whether it does."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        return False
    return True
