"""Processor time: of other processes, all their threads included, and what a virtual machine does not get."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
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


@dataclass(frozen=True)
class MachineTime:
    """Time of all processors since the machine started, in the kernel's ticks.

    Attributes:
        all: of every kind.
        stolen: in which a processor of a virtual machine had work, and its host let others run (proc(5), `steal`).
    """

    all: int
    stolen: int

    def stolen_share_since(self, before: MachineTime) -> float | None:
        """What share of the time since then was stolen; None if no tick has passed."""
        ticks = self.all - before.all
        return (self.stolen - before.stolen) / ticks if ticks > 0 else None


def machine_time(stat: Path = Path("/proc/stat")) -> MachineTime:
    """Time of this machine's processors so far."""
    # user, nice, system, idle, iowait, irq, softirq, steal; guests' time, which follows, is in user and nice already
    ticks = [int(text) for text in stat.read_text(encoding="ascii").split("\n", 1)[0].split()[1:9]]
    return MachineTime(all=sum(ticks), stolen=ticks[7])


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
