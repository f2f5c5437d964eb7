"""A control loop's place on shared cores: after the services, and ahead of all ordinary programs."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from deltaq_protocol.real_time import SchedulingPriority

GREED_S = 0.25
"""A controller that computes for so long without waiting for anything loses its priority: it is no control loop [s]."""

_THREADS = Path("/proc/self/task")


@contextlib.contextmanager
def ahead_of_ordinary_programs() -> Iterator[bool]:
    """Run a control loop with real-time priority, where the system allows it.

    All threads that the process has at the beginning take part, those that carry its messages among them. What is
    started within the block, a thread or a process, is ordinary. So is the controller itself from the moment when it
    has computed for `GREED_S` without waiting: it shall not keep the machine from others. Only a loop in the main
    thread asks.

    Yields:
        Whether the system allowed it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield False
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    before = signal.signal(signal.SIGXCPU, _give_back)
    resource.setrlimit(resource.RLIMIT_RTTIME, (_greed_us(hard), hard))
    try:
        yield _schedule_threads(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, SchedulingPriority.CONTROLLER)
    finally:
        _schedule_threads(os.SCHED_OTHER, 0)
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, hard))
        signal.signal(signal.SIGXCPU, before)


def _give_back(_signal: int, _frame: FrameType | None) -> None:
    _schedule_threads(os.SCHED_OTHER, 0)


def _greed_us(hard: int) -> int:
    asked = round(GREED_S * 1e6)
    return asked if hard == resource.RLIM_INFINITY else min(asked, hard)


def _schedule_threads(policy: int, priority: int) -> bool:
    """Give all threads of this process a policy; returns whether the system allows it."""
    for thread in [int(entry.name) for entry in _THREADS.iterdir()]:
        try:
            os.sched_setscheduler(thread, policy, os.sched_param(priority))
        except PermissionError:
            return False
        except ProcessLookupError:
            continue  # it has ended meanwhile
    return True
