"""The setpoints that the drives of one robot may still be at, one for each cycle that is known.

A setpoint leaves the history when as many cycles have passed as the drives lag. Two kinds of setpoints do not count as
a cycle, so that older ones stay longer: one that was sent again because the KRC missed it, and those that the robot may
have been sent in cycles of which no state came.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from deltaq_protocol.arrays import Array


class History:
    """The last setpoints of one robot, oldest first.

    Args:
        lag: how many setpoints back the drives may be.
    """

    def __init__(self, lag: int) -> None:
        self._lag = lag
        self._setpoints: deque[Array] = deque()
        self._passed: deque[bool] = deque()
        self._cycles = 0
        self._array: Array | None = None

    def sent(self, setpoint: Array, passed: bool = True) -> None:
        """A setpoint (n,) was sent, or may have been [rad or m]; `passed` if a cycle of the drives went by with it."""
        self._setpoints.append(setpoint)
        self._passed.append(passed)
        self._cycles += passed
        self._array = None
        while self._cycles > self._lag + 1 or (self._passed and not self._passed[0] and self.is_full):
            self._setpoints.popleft()
            self._cycles -= self._passed.popleft()

    def may_have_been_sent(self, setpoints: Iterable[Array]) -> None:
        """Some of these setpoints, each (n,), may have been sent [rad or m]."""
        for setpoint in setpoints:
            self.sent(setpoint, passed=False)

    @property
    def newest(self) -> Array:
        """(n,) present setpoint [rad or m]."""
        return self._setpoints[-1]

    @property
    def is_full(self) -> bool:
        """Whether it has every setpoint that the drives may be at."""
        return self._cycles > self._lag

    @property
    def rests(self) -> bool:
        """Whether the drives have had the time to come to the present setpoint."""
        return self.is_full and all((setpoint == self.newest).all() for setpoint in self._setpoints)

    def array(self) -> Array:
        """(k, n) all of them [rad or m]."""
        if self._array is None:
            self._array = np.array(self._setpoints)
        return self._array

    def snapshot(self) -> tuple[tuple[tuple[float, ...], ...], tuple[bool, ...]]:
        """The setpoints, and with which of them a cycle passed."""
        return tuple(tuple(setpoint.tolist()) for setpoint in self._setpoints), tuple(self._passed)

    def restore(self, setpoints: Sequence[Sequence[float]], passed: Sequence[bool]) -> None:
        """Go on from a snapshot; one of an earlier version does not say with which setpoints a cycle passed."""
        self._setpoints = deque(np.array(setpoint) for setpoint in setpoints)
        self._passed = deque(passed or [True] * len(setpoints))
        self._cycles = sum(self._passed)
        self._array = None
