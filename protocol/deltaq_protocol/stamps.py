"""Time stamps of increments at each station from controller to Robot Server, taken if asked for.

The environment variable `DELTAQ_STAMPS` names a folder. A process that finds it set puts its stamps into a ring that
is there from the start, and writes the ring into that folder when it ends; messages carry nothing more than usual.
Stamps of different processes can be compared, since CLOCK_MONOTONIC is one clock for all processes of a machine.
"""

import atexit
import itertools
import json
import os
import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.errors import DeltaqError

FOLDER = "DELTAQ_STAMPS"
"""Environment variable: where stamps are written; without it no process writes any."""

CAPACITY = 1 << 18
"""Stamps that a process keeps: four minutes of two robots at 12 ms, or one at 4 ms."""

_STAMP = struct.Struct("=5q")  # station, index of the robot, cycle, detail, time [ns]
_COLUMNS = 5


class StampStation(IntEnum):
    """Where a stamp is taken. Each member says what `cycle` and `detail` of its stamps are."""

    TELEGRAM = 0
    """The Robot Server has read a telegram; the robot's cycle that it begins."""
    STATE_OUT = 1
    """The state of a cycle has been published; `detail` is the `CycleOutcome`."""
    STATE_AT_CLIENT = 2
    """A controller has taken the state of a cycle."""
    INCREMENT_OUT = 3
    """A controller is about to send an increment; the cycle that it answers, and its sequence number."""
    INCREMENT_AT_HLI = 4
    """The HLI has taken an increment; as before."""
    REQUEST_AT_GATE = 5
    """The SIM has taken a request; as before."""
    DECISION_BEGUN = 6
    """The gate begins to decide; the cycle of the state that it decides on, and the request's sequence number."""
    DECIDED = 7
    """The gate has decided; as before."""
    ADMISSION_OUT = 8
    """The SIM has published an admission; the cycle after which it is taken."""
    ADMISSION_AT_SERVER = 9
    """An admission has come to the Robot Server's process; the cycle after which it is taken."""


class CycleOutcome(IntEnum):
    """The kind of setpoint that a Robot Server sent in a cycle."""

    FRESH = 0
    """An increment that was admitted for this cycle."""
    BRAKED = 1
    """The next step of the brake, or no motion after its end."""
    REPLY_MISSED = 2
    """The step before once more, because the KRC had not had it."""
    HELD = 3
    """Nothing: the robot is held, or not ready."""


class Stamps:
    """The stamps of one process; when the ring is full, each new one takes the place of the oldest.

    Args:
        process: its name.
        robots: robots whose stamps are kept; others are left out.
        capacity: of the ring.
    """

    def __init__(self, process: str, robots: Sequence[str], capacity: int = CAPACITY) -> None:
        self.process = process
        self._robots = {name: index for index, name in enumerate(robots)}
        self._capacity = capacity
        # filled, so that no page of it is touched for the first time in a cycle
        self._ring = bytearray(b"\xff") * (capacity * _STAMP.size)
        self._numbers = itertools.count()  # threads never get the same number twice

    def add(
        self, station: StampStation, robot: str, cycle: int, detail: int = 0, time_ns: int | None = None
    ) -> None:
        """Stamp now, or with a time that was taken before; any thread may.

        Args:
            station: the place of the stamp.
            robot: robot of the increment or state.
            cycle: its cycle, see `StampStation`.
            detail: see `StampStation`.
            time_ns: of CLOCK_MONOTONIC [ns].
        """
        now_ns = time.monotonic_ns() if time_ns is None else time_ns
        index = self._robots.get(robot)
        if index is None:
            return
        place = next(self._numbers) % self._capacity * _STAMP.size
        _STAMP.pack_into(self._ring, place, station, index, cycle, detail, now_ns)

    def write(self, folder: Path) -> Path:
        """Write all stamps into a file of this process; returns its path. No stamp may be added afterwards."""
        count = next(self._numbers)
        kept, begin = min(count, self._capacity), count % self._capacity * _STAMP.size
        oldest_first = self._ring[begin:] + self._ring[:begin] if count > self._capacity else self._ring
        head = {
            "process": self.process,
            "robots": list(self._robots),
            "kept": kept,
            "overwritten": count - kept,
        }
        file = folder / f"{self.process}-{os.getpid()}.stamps"
        file.write_bytes(json.dumps(head).encode() + b"\n" + oldest_first[: kept * _STAMP.size])
        return file


@dataclass(frozen=True)
class WrittenStamps:
    """The written stamps of one process.

    Attributes:
        process: its name.
        robots: names, by their index.
        overwritten: how many older stamps were lost because the ring was full.
        rows: (n, 5) station, index of the robot, cycle, detail, time [ns]; in the order in which they were taken.
    """

    process: str
    robots: tuple[str, ...]
    overwritten: int
    rows: NDArray[np.int64]


def stamps_if_asked(process: str, robots: Sequence[str]) -> Stamps | None:
    """The ring of this process, which is written when the process ends; None unless the environment asks for it.

    Args:
        process: name, the same file for the same name.
        robots: whose stamps are kept.
    """
    folder = os.environ.get(FOLDER)
    return _kept(process, tuple(robots), folder) if folder else None


@cache
def _kept(process: str, robots: tuple[str, ...], folder: str) -> Stamps:
    stamps = Stamps(process, robots)
    atexit.register(stamps.write, Path(folder))
    return stamps


def read_stamps(file: Path) -> WrittenStamps:
    """Read what `Stamps.write` wrote.

    Raises:
        DeltaqError: if the file is cut short or holds no stamps.
    """
    head, _, body = file.read_bytes().partition(b"\n")
    try:
        told = json.loads(head)
        process, robots, kept = str(told["process"]), tuple(told["robots"]), int(told["kept"])
        overwritten = int(told["overwritten"])
    except (ValueError, KeyError, TypeError) as error:
        raise DeltaqError(f"{file} has no header of stamps: {error!r}") from error
    if len(body) != kept * _STAMP.size:
        raise DeltaqError(
            f"{file} holds {len(body)} bytes of stamps, and its header says {kept} of {_STAMP.size}"
        )
    rows = np.frombuffer(body, dtype="=i8").astype(np.int64).reshape(-1, _COLUMNS)
    return WrittenStamps(process, robots, overwritten, rows)
