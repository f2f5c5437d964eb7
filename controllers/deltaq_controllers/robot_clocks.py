"""The clocks of a cell's Robot Servers, which may be on as many hosts: one clock for each robot's path.

All are read with the same exchanges. What is wrong with these is wrong with all clocks alike, so that between two
robots it cancels out: how much older one's state is than the other's is known better than the age of either.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from deltaq_protocol.client import Cell
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import RobotState, Status

# Offsets of other hosts' clocks, to compute the age of their states.
#
# As NTP does (RFC 5905, 8 and 10): a request and its answer enclose the moment at which the other clock was
# read. With equal delays in both directions that moment is the middle. Otherwise the error is half of the
# difference, at most half of the round trip. The quickest round trip is used, since delays are seldom symmetric.
# Clocks drift, so an estimate ages, and a slower round trip may be better later.

MAX_DRIFT = 1e-4
"""By how much two clocks go apart at most [s/s]: crystals are within 50 ppm, of either sign."""


class _Reading(NamedTuple):
    asked_s: float
    offset_s: float
    error_s: float

    def error_at_s(self, now_s: float) -> float:
        return self.error_s + MAX_DRIFT * max(now_s - self.asked_s, 0.0)

    def agrees(self, other: _Reading) -> bool:
        return abs(self.offset_s - other.offset_s) <= self.error_s + other.error_at_s(self.asked_s)


class PathClock:
    """The clock at the other end of one path.

    Attributes:
        offset_s: time of that clock minus time of this one [s]; 0 before the first exchange.
    """

    def __init__(self) -> None:
        self._believed = _Reading(0.0, 0.0, math.inf)
        self._doubted: _Reading | None = None

    @property
    def offset_s(self) -> float:
        """Time of that clock minus time of this one [s]; 0 before the first exchange."""
        return self._believed.offset_s

    @property
    def known(self) -> bool:
        """Whether there was an exchange."""
        return math.isfinite(self._believed.error_s)

    def error_s(self, now_s: float) -> float:
        """By how much the offset may be wrong now at most [s]; infinite before the first exchange."""
        return self._believed.error_at_s(now_s)

    def take(self, asked_s: float, stamp_s: float, answered_s: float) -> None:
        """Add an exchange.

        An exchange that contradicts the estimate shows that a clock was set, or that a stamp was late: it is used
        once another confirms it.

        Args:
            asked_s: when the request went out, on this clock [s].
            stamp_s: time of the other clock, read in between [s].
            answered_s: when the answer had come, on this clock [s].

        Raises:
            ValueError: the answer was there before the request, so the clock was set.
        """
        if answered_s < asked_s:
            raise ValueError(f"answered_s: {answered_s} is before the request, {asked_s}")
        error_s = (answered_s - asked_s) / 2.0
        reading = _Reading(asked_s, stamp_s - (asked_s + answered_s) / 2.0, error_s)
        doubted, self._doubted = self._doubted, None
        if not reading.agrees(self._believed):
            if doubted is None or not reading.agrees(doubted):
                self._doubted = reading
                return
            self._believed = reading
        elif error_s < self._believed.error_at_s(answered_s):
            self._believed = reading

    def summary(self, now_s: float) -> dict[str, float | None]:
        """Offset and bound of its error now [s] as a JSON object; None before the first exchange."""
        return {
            "offset_s": self.offset_s if self.known else None,
            "error_s": self.error_s(now_s) if self.known else None,
        }

    def age_s(self, stamp_s: float, now_s: float) -> float:
        """Age [s] of a stamp of the other clock [s] at a time of this clock [s]."""
        return now_s - (stamp_s - self.offset_s)


def robot_clock_s(status: Status, newest: RobotState, cycle_s: float) -> float | None:
    """Time of the Robot Server's clock when the HLI answered with a status [s].

    The answer names the newest cycle and its age. Its stamp follows from that of a state that had come before, by whole
    cycles: the KRC counts them evenly.

    Args:
        status: the answer.
        newest: a state of the robot that came before the request.
        cycle_s: cycle of the robot [s].

    Returns:
        The time, too early by a state's delay from the Robot Server to the HLI; None if the HLI knows no state, or
        only those of a restarted Robot Server.
    """
    robot = status.robots.get(newest.robot)
    if robot is None or robot.state_age_s is None or robot.cycle < newest.cycle:
        return None
    return newest.time_s + (robot.cycle - newest.cycle) * cycle_s + robot.state_age_s


class RobotClocks:
    """Offsets of the robots' clocks, and conversion of one clock's stamps to another.

    Args:
        robots: their names.
        cycle_s: cycle of all of them [s].
    """

    def __init__(self, robots: Iterable[str], cycle_s: float) -> None:
        self._clocks = {name: PathClock() for name in robots}
        self._cycle_s = cycle_s
        self._moved: dict[tuple[str, str], tuple[float, float]] = {}

    def take(
        self, asked_s: float, status: Status, answered_s: float, newest: Mapping[str, RobotState]
    ) -> None:
        """Add an exchange.

        Args:
            asked_s: when the HLI was asked, on this clock [s].
            status: its answer.
            answered_s: when that had come, on this clock [s].
            newest: of each robot that was heard, a state that had come when it was asked.
        """
        for name, state in newest.items():
            stamp_s = robot_clock_s(status, state, self._cycle_s)
            if stamp_s is not None:
                self._clocks[name].take(asked_s, stamp_s, answered_s)

    def knows(self, robot: str) -> bool:
        """Whether the clock of a robot was read."""
        return self._clocks[robot].known

    def on_clock_of(self, robot: str, other: str, stamp_s: float) -> float | None:
        """A stamp of `other` [s] on the clock of `robot` [s]; None while one of them is not known.

        The newest stamp does not change when clocks are read again, so that a state seen twice is not taken for two.
        """
        own, its = self._clocks[robot], self._clocks[other]
        if not (own.known and its.known):
            return None
        before = self._moved.get((robot, other))
        if before is None or before[0] != stamp_s:
            before = self._moved[robot, other] = (stamp_s, stamp_s - its.offset_s + own.offset_s)
        return before[1]

    def age_s(self, robot: str, stamp_s: float, now_s: float) -> float | None:
        """Age of a stamp of a robot's server at the present time of this clock [s]; None while the clock is unknown."""
        clock = self._clocks[robot]
        return clock.age_s(stamp_s, now_s) if clock.known else None

    def summary(self, now_s: float) -> dict[str, dict[str, float | None]]:
        """Offset of each robot's clock to this one and the bound of its error now [s], as a JSON object."""
        return {name: clock.summary(now_s) for name, clock in self._clocks.items()}


# Reads the clocks of the Robot Servers of a running cell, and reads them again now and then: clocks drift.


_EXCHANGES = 5
"""Requests by which clocks are read at first; the quickest is believed."""
_AGAIN_S, _SOON_S = 2.0, 0.1
"""Time between two exchanges, and while the clock of a robot that is heard is not known."""


class ClockReading:
    """Keeps the clocks of a cell's robots up to date.

    Args:
        cell: connection to the cell.

    Attributes:
        clocks: the clocks, as far as they are known.
    """

    def __init__(self, cell: Cell) -> None:
        self.clocks = RobotClocks(cell.robots, cell.description.cycle_s)
        self._cell = cell
        self._asked_s = -_AGAIN_S
        self._under_way: asyncio.Task[None] | None = None

    async def read_first(self) -> None:
        """Read the clocks of all robots whose states arrive.

        Of a busy machine some answers come too late, and tell nothing of a clock.

        Raises:
            ServiceUnreachableError: none has come in time.
        """
        unanswered = 0
        for _ in range(_EXCHANGES):
            try:
                await self._exchange()
            except ServiceUnreachableError:
                unanswered += 1
                if unanswered == _EXCHANGES:
                    raise

    def go_on(self) -> None:
        """Ask again if it is due; to be called once a cycle. The answer is not waited for, and one may be missing."""
        if self._under_way is not None and not self._under_way.done():
            return
        heard = [name for name in self._cell.robots if self._cell.state(name) is not None]
        pause_s = _AGAIN_S if all(map(self.clocks.knows, heard)) else _SOON_S
        if time.monotonic() >= self._asked_s + pause_s:
            self._under_way = asyncio.create_task(self._exchange_if_answered())

    async def _exchange_if_answered(self) -> None:
        with contextlib.suppress(ServiceUnreachableError):
            await self._exchange()

    async def _exchange(self) -> None:
        states = {name: self._cell.state(name) for name in self._cell.robots}
        newest = {name: state for name, state in states.items() if state is not None}
        self._asked_s = asked_s = time.monotonic()
        status = await self._cell.status()
        self.clocks.take(asked_s, status, time.monotonic(), newest)
