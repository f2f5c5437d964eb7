"""How regularly messages come: arithmetic on arrival times, and an observer of a running cell."""

import itertools
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from deltaq_deploy.launch.cell_connection import Listener
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.messages import RobotState


@dataclass(frozen=True)
class Regularity:
    """Regularity of one stream.

    Attributes:
        count: messages that came.
        rate_hz: mean rate, None before the second message.
        period_median_s: median time between two messages.
        period_p99_s: 99th percentile of it.
        period_max_s: longest of it.
    """

    count: int
    rate_hz: float | None
    period_median_s: float | None
    period_p99_s: float | None
    period_max_s: float | None


def rate_of(times_s: list[float]) -> Regularity:
    """Rate and regularity of messages that arrived at `times_s`, ascending [s]."""
    if len(times_s) < 2:
        return Regularity(len(times_s), None, None, None, None)
    periods = sorted(after - before for before, after in itertools.pairwise(times_s))
    span = times_s[-1] - times_s[0]
    return Regularity(
        count=len(times_s),
        rate_hz=len(periods) / span if span > 0 else None,
        period_median_s=percentile(periods, 0.5),
        period_p99_s=percentile(periods, 0.99),
        period_max_s=periods[-1],
    )


def percentile(ordered: list[float], share: float) -> float:
    """The value that a fraction `share` of all values do not exceed, by nearest rank; `ordered` is not empty."""
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


_BATCH = 16
"""States that are decoded together: so few that it takes a millisecond, and delays no stamp by more."""


@dataclass
class Track:
    """Observations of one robot.

    Attributes:
        times_s: arrival of each state on this process's clock [s].
        lower: least position of each joint seen [rad or m].
        upper: greatest position of each joint seen [rad or m].
        missed: cycles whose state did not arrive.
    """

    times_s: list[float] = field(default_factory=list)
    lower: tuple[float, ...] = ()
    upper: tuple[float, ...] = ()
    missed: int = 0
    _last_cycle: int | None = None

    def take(self, state: RobotState, time_s: float) -> None:
        """Add one state that arrived at `time_s`."""
        self.times_s.append(time_s)
        self.lower = tuple(map(min, self.lower or state.q, state.q))
        self.upper = tuple(map(max, self.upper or state.q, state.q))
        if self._last_cycle is not None:
            self.missed += max(0, state.cycle - self._last_cycle - 1)
        self._last_cycle = state.cycle

    @property
    def rate(self) -> Regularity:
        """Regularity of the states."""
        return rate_of(self.times_s)

    @property
    def travel(self) -> tuple[float, ...]:
        """Range that each joint moved through [rad or m]."""
        return tuple(upper - lower for lower, upper in zip(self.lower, self.upper, strict=True))


class Observer:
    """Watches the states of robots from its construction to `close`.

    States are stamped as they come and decoded later, some at a time, to take no processor time from the watched
    cell.
    """

    def __init__(self, listener: Listener, robots: Sequence[str]) -> None:
        self.tracks = {robot: Track() for robot in robots}
        self._waiting: list[tuple[float, bytes]] = []
        self._lock = threading.Lock()  # zenoh calls back from its own threads
        self._subscribers = [listener.subscribe(topics.STATE, self._take, robot) for robot in robots]

    def close(self) -> None:
        """Stop watching; `tracks` is complete then."""
        for subscriber in self._subscribers:
            subscriber.undeclare()
        with self._lock:
            self._decode()

    def _take(self, sample: Any) -> None:
        now = time.monotonic()
        with self._lock:
            self._waiting.append((now, sample.payload.to_bytes()))
            if len(self._waiting) >= _BATCH:
                self._decode()

    def _decode(self) -> None:
        waiting, self._waiting = self._waiting, []
        for time_s, payload in waiting:
            state = unpack(RobotState, payload)
            self.tracks[state.robot].take(state, time_s)
