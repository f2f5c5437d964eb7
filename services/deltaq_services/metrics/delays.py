"""How long after a robot's state its verdict came, where both are heard."""

from __future__ import annotations

from collections import OrderedDict

_KEPT = 64
"""Cycles whose verdicts may still come."""


class Delays:
    """Of one robot; the shell passes the time in."""

    def __init__(self) -> None:
        self._came: OrderedDict[int, float] = OrderedDict()
        self._last_s: float | None = None

    def state(self, cycle: int, time_s: float) -> float | None:
        """A state has come; returns the time since the one before it [s], None for the first."""
        interval_s = None if self._last_s is None else time_s - self._last_s
        self._last_s = self._came[cycle] = time_s
        if len(self._came) > _KEPT:
            self._came.popitem(last=False)
        return interval_s

    def verdict(self, cycle: int, time_s: float) -> float | None:
        """A verdict on that cycle has come; returns how long after its state [s], None if that was not heard."""
        came_s = self._came.get(cycle)
        return None if came_s is None else time_s - came_s
