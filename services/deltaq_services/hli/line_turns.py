"""Whose line is served next, when many wait. Plain decisions; the shell passes the time in.

Connections that hold a lease come first, since a robot waits for them; the others follow in turn, one line each. Every
connection has a rate, and those without a lease have one together, so that however many they are, time is left for the
states of the robots. A line beyond a rate waits; it is not lost, and its sender is the one who waits.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

from deltaq_services.rate_limit import RateLimit

C = TypeVar("C", bound=Hashable)

MOST_LINES_S = 2000.0
"""Lines a second of one connection: several times what it takes to move two robots every 4 ms."""
MOST_TOGETHER_S = 2000.0
"""Lines a second of all connections together that hold no lease."""


class LineTurns(Generic[C]):
    """The connections that have a line waiting, and how many lines each may still send.

    Args:
        most_lines_s: lines a second of one connection.
        most_together_s: lines a second of all connections without a lease together.
    """

    def __init__(self, most_lines_s: float = MOST_LINES_S, most_together_s: float = MOST_TOGETHER_S) -> None:
        self._most_lines_s = most_lines_s
        self._together = RateLimit(most_together_s)
        self._rates: dict[C, RateLimit] = {}
        # dictionaries as queues: each connection once, the one that waits longest first
        self._holders: dict[C, None] = {}
        self._others: dict[C, None] = {}

    def __bool__(self) -> bool:
        """Whether a line waits."""
        return bool(self._holders or self._others)

    def wait(self, connection: C, is_holder: bool) -> None:
        """A connection has a line waiting."""
        mine, other = (self._holders, self._others) if is_holder else (self._others, self._holders)
        other.pop(connection, None)
        mine.setdefault(connection)

    def leave(self, connection: C) -> None:
        """A connection has ended."""
        self._holders.pop(connection, None)
        self._others.pop(connection, None)
        self._rates.pop(connection, None)

    def next(self, time_s: float) -> C | None:
        """The connection whose line is served now; None if none may be yet. It waits again only after `wait`."""
        for connection in self._holders:
            if self._rate(connection).take(time_s):
                del self._holders[connection]
                return connection
        for connection in self._others:
            if self._rate(connection).take(time_s):
                if not self._together.take(time_s):
                    return None
                del self._others[connection]
                return connection
        return None

    def _rate(self, connection: C) -> RateLimit:
        return self._rates.setdefault(connection, RateLimit(self._most_lines_s))
