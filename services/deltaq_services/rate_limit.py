"""How many messages one sender may send: so many a second, and as many at once."""

from __future__ import annotations

import math

from deltaq_services.containment import Part


class RateLimit(Part):
    """A bucket that fills with time and from which each message takes one.

    Args:
        most_s: messages a second.
        at_once: the most at once; as many as in a second if it is not given.

    Attributes:
        most_s: as given.
    """

    def __init__(self, most_s: float, at_once: float | None = None) -> None:
        self.most_s = most_s
        self._full = most_s if at_once is None else at_once
        self._left = self._full
        self._at_s: float | None = None

    def has_left(self, now_s: float) -> bool:
        """Whether one more would be allowed now."""
        since_s = 0.0 if self._at_s is None else now_s - self._at_s
        return self._left + since_s * self.most_s >= 1.0

    def take(self, now_s: float) -> bool:
        """Whether one more is allowed now."""
        if self._at_s is not None:
            self._left = min(self._full, self._left + (now_s - self._at_s) * self.most_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


# Guessing at tokens, kept slow. Plain decisions; the shell passes the time in.

MOST_TRIES_S = 3.0
"""Wrong tokens a second of one peer; what comes beyond is not compared."""
_MOST_PEERS = 256


class Tries:
    """Wrong tokens, by the address that they came from: only so many of each are compared in a second."""

    def __init__(self) -> None:
        self._rates: dict[str, RateLimit] = {}

    def may_try(self, address: str, time_s: float) -> bool:
        """Whether a token from there is compared at all."""
        return address not in self._rates or self._rates[address].has_left(time_s)

    def failed(self, address: str, time_s: float) -> None:
        """A wrong token came from there."""
        while len(self._rates) >= _MOST_PEERS and address not in self._rates:
            del self._rates[next(iter(self._rates))]
        self._rates.setdefault(address, RateLimit(MOST_TRIES_S)).take(time_s)


# Keeping the pace that the table of topics sets, for whoever publishes by the clock.

_EARLY = 0.25
"""Share of a period that a message may come early, so that two clocks of one pace do not miss every other beat."""


class Pace(Part):
    """Says when the next message is due.

    Args:
        period_s: from one message to the next [s].
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = -math.inf

    def due(self, time_s: float) -> bool:
        """Whether a message is due at `time_s`; if so, it counts as sent."""
        if time_s < self._next_s - _EARLY * self._period_s:
            return False
        # after a pause there is nothing to catch up with
        self._next_s = max(self._next_s, time_s - _EARLY * self._period_s) + self._period_s
        return True
