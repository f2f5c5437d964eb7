"""The reference of the live benchmark: the same hops between bare sockets, in the same run, on the same cores."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltaq_experiments.bench.native import NativeProgram, program
from deltaq_experiments.bench.processor_time import processor_seconds
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.stamps import StampStation

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
"""By how much it runs longer than what it is compared with, so that its processor time can still be read."""
_ENDS_WITHIN_S = 10.0


class HopReferenceError(DeltaqError):
    """The reference did not run to its end."""


@dataclass(frozen=True)
class HopTimes:
    """What the reference measured.

    Attributes:
        language: that it is written in, for people.
        cycle_s: its messages were sent once in this time [s].
        rows: (n, 6) when each message was sent, and when each hop had it; 0 where it did not come back [ns].
    """

    language: str
    cycle_s: float
    rows: NDArray[np.int64]

    def ages_s(self, hops: int) -> list[float]:
        """Age of each message after so many hops, of those that came back [s]."""
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
    """The reference's processes while they run, and what they measured once they have ended.

    Args:
        made: its program.
        cycle_s: a message is sent once in this time [s].
        duration_s: of the window that it is compared with, which begins now [s].
        folder: for its file.
    """

    def __init__(self, made: NativeProgram, cycle_s: float, duration_s: float, folder: Path) -> None:
        self._made, self._cycle_s = made, cycle_s
        self._length_s = duration_s + _LONGER_S
        self._file = folder / "hops.bin"
        cycles = max(1, math.floor(self._length_s / cycle_s))
        arguments = (f"{round(cycle_s * 1e9)}", f"{cycles}", f"{MESSAGE_BYTES}", f"{self._file}")
        self.process = subprocess.Popen([*made.command, *arguments], stderr=subprocess.PIPE, text=True)

    def processor_s(self) -> float:
        """Processor time of all its processes so far, while they run [s]."""
        return processor_seconds(self.process.pid, with_children=True)

    def times(self, begin_ns: int, end_ns: int) -> HopTimes:
        """Wait for its end; of what it measured, what was sent within a window [ns].

        Raises:
            HopReferenceError: if it fails, or does not end.
        """
        try:
            _, said = self.process.communicate(timeout=self._length_s + _ENDS_WITHIN_S)
        except subprocess.TimeoutExpired as error:
            raise HopReferenceError("the reference of bare sockets did not end") from error
        if self.process.returncode != 0:
            raise HopReferenceError(
                f"the reference of bare sockets ended with {self.process.returncode}: {said}"
            )
        rows = np.fromfile(self._file, dtype="=i8").astype(np.int64).reshape(-1, _STAMPS)
        within = (rows[:, 0] >= begin_ns) & (rows[:, 0] < end_ns)
        return HopTimes(self._made.language, self._cycle_s, rows[within])


@contextmanager
def hop_reference(
    cycle_s: float, duration_s: float, folder: Path, compiler: str | None = None
) -> Iterator[HopReference]:
    """Start the reference; it is killed if the block is left before it has ended.

    Args:
        cycle_s: a message is sent once in this time [s].
        duration_s: how long [s].
        folder: for its files.
        compiler: see `native.program`.
    """
    reference = HopReference(program("hops", folder, compiler), cycle_s, duration_s, folder)
    try:
        yield reference
    finally:
        reference.process.kill()
        reference.process.communicate()
