"""Keeping the pace that the table of topics sets, for whoever publishes by the clock."""

from __future__ import annotations

import math

_EARLY = 0.25
"""Share of a period that a message may come early, so that two clocks of one pace do not miss every other beat."""


class Pace:
    """Says when the next message is due.

    Args:
        period_s: from one message to the next [s].
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = -math.inf

    def snapshot(self) -> float:
        """When the next message is due [s]."""
        return self._next_s

    def restore(self, next_s: float) -> None:
        """Go on from where another was."""
        self._next_s = next_s

    def due(self, time_s: float) -> bool:
        """Whether a message is due at `time_s`; if so, it counts as sent."""
        if time_s < self._next_s - _EARLY * self._period_s:
            return False
        # after a pause there is nothing to catch up with
        self._next_s = max(self._next_s, time_s - _EARLY * self._period_s) + self._period_s
        return True
