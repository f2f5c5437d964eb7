"""Rates of messages: how many a sender may send, when the next is due, which streams lag. Users pass the time in."""

import math
from collections import deque

from deltaq_protocol.topic import Topic
from deltaq_services.containment import Part

SLOW = 0.8
"""Share of its rate below which a stream lags."""
_LEAST = 10
_WINDOW_S = 1.0


def lags(topic: Topic, cycle_s: float, rate_hz: float | None) -> bool:
    """Whether a stream of `rate_hz` messages a second (None: none) is slower than the table requires."""
    expected_hz = topic.steady_hz(cycle_s)
    return expected_hz is not None and (rate_hz is None or rate_hz < SLOW * expected_hz)


class Heard(Part):
    """One stream of one publisher.

    Args:
        name: its name in texts.
        topic: its row in the table of topics, with a steady rate and a greatest age.
        cycle_s: sampling time of the robots [s].
        bound_s: the cell's bound on its age, if there is one [s].
    """

    def __init__(self, name: str, topic: Topic, cycle_s: float, bound_s: float = math.inf) -> None:
        self.name = name
        self._topic, self._cycle_s = topic, cycle_s
        self._age_s = topic.age_s(cycle_s, bound_s)
        self._times_s: deque[float] = deque(
            maxlen=max(_LEAST, math.ceil(_WINDOW_S / topic.period_s(cycle_s)))
        )

    def at(self, time_s: float) -> None:
        """Count a received message."""
        self._times_s.append(time_s)

    def fault(self, time_s: float) -> str | None:
        """The fault of the stream as text; None if it has none."""
        times_s = self._times_s
        if not times_s:
            return f"{self.name}: no {self._topic.name} yet"
        age_s = time_s - times_s[-1]
        if age_s > self._age_s:
            return f"{self.name}: no {self._topic.name} for {age_s:.1f} s, at most {self._age_s:g} s"
        span_s = times_s[-1] - times_s[0]
        if len(times_s) < _LEAST or span_s <= 0.0:
            return None
        rate_hz = (len(times_s) - 1) / span_s
        if not lags(self._topic, self._cycle_s, rate_hz):
            return None
        return f"{self.name}: {self._topic.name} at {rate_hz:.1f} Hz, expected {self._expected_hz:.1f} Hz"

    @property
    def _expected_hz(self) -> float:
        return 1.0 / self._topic.period_s(self._cycle_s)


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
"""Wrong tokens a second of one peer; further tokens are not compared."""
_MOST_PEERS = 256


class Tries:
    """Wrong tokens, by the address that they came from: only so many of each are compared in a second."""

    def __init__(self) -> None:
        self._rates: dict[str, RateLimit] = {}

    def may_try(self, address: str, time_s: float) -> bool:
        """Whether a token from there is compared at all."""
        return address not in self._rates or self._rates[address].has_left(time_s)

    def failed(self, address: str, time_s: float) -> None:
        """Count a wrong token from an address."""
        while len(self._rates) >= _MOST_PEERS and address not in self._rates:
            del self._rates[next(iter(self._rates))]
        self._rates.setdefault(address, RateLimit(MOST_TRIES_S)).take(time_s)


# The pace of a topic, for publishers that go by the clock.

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
