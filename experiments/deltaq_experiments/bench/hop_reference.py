"""The reference of the live benchmark: the same hops between bare sockets, in the same run, on the same cores."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.stamps import StampStation

# References in C, compiled for the run.

_HERE = Path(__file__).parent


def program(name: str, folder: Path) -> str:
    """The program of `NAME.c` of this folder, made by the compiler that CC names, or by `cc`.

    Args:
        name: of the program.
        folder: for the executable.

    Raises:
        DeltaqError: if there is no compiler, or it cannot compile it.
    """
    compiler = os.environ.get("CC") or "cc"
    found = shutil.which(compiler)
    if found is None:
        raise DeltaqError(
            f"the reference is a C program, and there is no compiler {compiler!r}: install one, or name it in CC"
        )
    made = folder / name
    command = [found, "-std=gnu11", "-O2", "-o", str(made), str(_HERE / f"{name}.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise DeltaqError(f"{' '.join(command)} failed:\n{done.stderr.strip()}")
    return str(made)


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


def wakeups(pid: int) -> int:
    """How often the threads of a process have waited for something so far, and been woken.

    Raises:
        ProcessLookupError: if it has ended.
    """
    count = 0
    for status in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(OSError):  # a thread has ended since
            told = status.read_text(encoding="ascii")
            count += int(told.partition("\nvoluntary_ctxt_switches:")[2].split()[0])
    if count == 0:
        raise ProcessLookupError(f"process {pid} has ended")
    return count


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
        raise ProcessLookupError(f"process {pid} has ended, or its time cannot be read") from error


def _children(pid: int) -> list[int]:
    return [
        int(child)
        for file in Path(f"/proc/{pid}/task").glob("*/children")
        for child in file.read_text(encoding="ascii").split()
    ]


MESSAGE_BYTES = 600
"""As large as the packed state of a robot; an increment is half as long."""

HOPS = {
    StampStation.STATE_AT_CLIENT: 2,
    StampStation.INCREMENT_OUT: 2,
    StampStation.INCREMENT_AT_HLI: 3,
    StampStation.REQUEST_AT_GATE: 4,
    StampStation.DECISION_BEGUN: 4,
    StampStation.DECIDED: 4,
    StampStation.ADMISSION_OUT: 4,
    StampStation.ADMISSION_AT_SERVER: 5,
}
"""Hops from the Robot Server that a message has behind it at each station."""

_STAMPS = 6
_LONGER_S = 1.0
"""Time by which the reference runs longer than the cell [s], so that its processor time can still be read."""
_ENDS_WITHIN_S = 10.0


@dataclass(frozen=True)
class HopTimes:
    """Results of the reference.

    Attributes:
        cycle_s: its messages were sent once in this time [s].
        rows: (n, 6) when each message was sent, and when each hop had it; 0 where it did not come back [ns].
    """

    cycle_s: float
    rows: NDArray[np.int64]

    def ages_s(self, hops: int) -> list[float]:
        """Age of each returned message after a number of hops [s]."""
        back = self.rows[self.rows[:, -1] > 0]
        ages: list[float] = ((back[:, hops] - back[:, 0]) / 1e9).tolist()
        return ages

    @property
    def in_time(self) -> float:
        """Share of messages that were back within their cycle."""
        if len(self.rows) == 0:
            return 0.0
        took_ns = self.rows[:, -1] - self.rows[:, 0]
        return float(np.mean((self.rows[:, -1] > 0) & (took_ns < self.cycle_s * 1e9)))

    @property
    def longest_client_cycle_s(self) -> float | None:
        """Longest time between two messages at the controller's place [s]; None with fewer than two."""
        came_ns = self.rows[self.rows[:, 2] > 0, 2]
        return float(np.max(np.diff(came_ns))) / 1e9 if len(came_ns) > 1 else None


class HopReference:
    """The reference's processes, and their measurements once they have ended.

    Args:
        made: its program.
        cycle_s: a message is sent once in this time [s].
        duration_s: length of the window of comparison, which begins now [s].
        folder: for its file.
    """

    def __init__(self, made: str, cycle_s: float, duration_s: float, folder: Path) -> None:
        self._cycle_s = cycle_s
        self._length_s = duration_s + _LONGER_S
        self._file = folder / "hops.bin"
        cycles = max(1, math.floor(self._length_s / cycle_s))
        arguments = (f"{round(cycle_s * 1e9)}", f"{cycles}", f"{MESSAGE_BYTES}", f"{self._file}")
        self.process = subprocess.Popen([made, *arguments], stderr=subprocess.PIPE, text=True)

    def processor_s(self) -> float:
        """Processor time of all its processes so far, while they run [s]."""
        return processor_seconds(self.process.pid, with_children=True)

    def times(self, begin_ns: int, end_ns: int) -> HopTimes:
        """Wait for its end; returns the measurements of messages that were sent within a window [ns].

        Raises:
            DeltaqError: if it fails, or does not end.
        """
        try:
            _, said = self.process.communicate(timeout=self._length_s + _ENDS_WITHIN_S)
        except subprocess.TimeoutExpired as error:
            raise DeltaqError("the reference of bare sockets did not end") from error
        if self.process.returncode != 0:
            raise DeltaqError(f"the reference of bare sockets ended with {self.process.returncode}: {said}")
        rows = np.fromfile(self._file, dtype="=i8").astype(np.int64).reshape(-1, _STAMPS)
        within = (rows[:, 0] >= begin_ns) & (rows[:, 0] < end_ns)
        return HopTimes(self._cycle_s, rows[within])


@contextmanager
def hop_reference(cycle_s: float, duration_s: float, folder: Path) -> Iterator[HopReference]:
    """Start the reference; it is killed if the block is left before it has ended.

    Args:
        cycle_s: a message is sent once in this time [s].
        duration_s: how long [s].
        folder: for its files.
    """
    reference = HopReference(program("hops", folder), cycle_s, duration_s, folder)
    try:
        yield reference
    finally:
        reference.process.kill()
        reference.process.communicate()
