"""Who goes first where processes share cores."""

from __future__ import annotations

import os


def ask_for_real_time(priority: int) -> None:
    """Real-time priority for this thread, and those that it starts from here on, where the system allows it.

    Whoever is nearer to the motors has to go first: what drives them before its Robot Server, that before the gate,
    the gate before the HLI, whose clients might keep it busy.

    Args:
        priority: of SCHED_FIFO, the greater the sooner.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        print("no real-time priority: the system does not allow it to this user", flush=True)
