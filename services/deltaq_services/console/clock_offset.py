"""How old a browser's message is, whatever time its clock shows.

A message says when it was sent on its sender's clock. The difference to the time of its arrival is the clocks' offset
and the way that it took; the least difference of the last seconds is the offset with the shortest way. What a message
has above that, it was late. Clocks that are an hour apart make no difference, and neither does their slow drift.

The least difference is kept by the second. A line that stands still brings nothing, so no second of it counts: what
then comes at once, in one second, is measured against what came before it.
"""

from __future__ import annotations

from collections import deque

SECONDS_KEPT = 10
"""Seconds with messages over which the least difference is taken: after these, a clock that was set is believed."""


class ClockOffset:
    """Of one connection."""

    def __init__(self) -> None:
        self._least: deque[tuple[int, float]] = deque(maxlen=SECONDS_KEPT)

    def hear(self, sent_s: float, arrived_s: float) -> float:
        """A message has come; returns how late it was [s], 0 for the first.

        Args:
            sent_s: on the sender's clock [s].
            arrived_s: on this clock [s].
        """
        difference, second = arrived_s - sent_s, int(arrived_s)
        if self._least and self._least[-1][0] == second:
            self._least[-1] = (second, min(self._least[-1][1], difference))
        else:
            self._least.append((second, difference))
        return difference - min(least for _, least in self._least)
