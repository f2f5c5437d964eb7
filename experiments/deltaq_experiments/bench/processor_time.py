"""Processor time of other processes, all their threads included, from the kernel's clock of each."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

_SCHED = 2
"""CPUCLOCK_SCHED of the kernel's include/linux/posix-timers.h: time that a process ran."""


def processor_seconds(pid: int, with_children: bool = False) -> float:
    """Processor time of a process so far [s].

    Args:
        pid: of the process, which runs.
        with_children: children that run count as well.

    Raises:
        ProcessLookupError: if it has ended.
    """
    own = _clock(pid)
    if with_children:
        for child in _children(pid):
            with suppress(ProcessLookupError):  # it has ended since
                own += _clock(child)
    return own


def _clock(pid: int) -> float:
    try:
        # MAKE_PROCESS_CPUCLOCK of the same header: what clock_getcpuclockid(3) returns
        return time.clock_gettime(((~pid) << 3) | _SCHED)
    except OSError as error:
        raise ProcessLookupError(f"process {pid} has ended, or its time is not told") from error


def _children(pid: int) -> list[int]:
    return [
        int(child)
        for file in Path(f"/proc/{pid}/task").glob("*/children")
        for child in file.read_text(encoding="ascii").split()
    ]
