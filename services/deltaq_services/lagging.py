"""What lags: streams that have gone silent, or come more slowly than the table of topics says.

Pure: told the time by whoever listens.
"""

from __future__ import annotations

import math
from collections import deque

from deltaq_protocol.topic import Topic
from deltaq_services.containment import Part

SLOW = 0.8
"""Share of its rate below which a stream lags."""
_LEAST = 10
_WINDOW_S = 1.0


def lags(topic: Topic, cycle_s: float, rate_hz: float | None) -> bool:
    """Whether a stream that comes `rate_hz` times a second (None: not at all) is slower than the table says."""
    expected_hz = topic.steady_hz(cycle_s)
    return expected_hz is not None and (rate_hz is None or rate_hz < SLOW * expected_hz)


class Heard(Part):
    """One stream of one publisher.

    Args:
        name: for people.
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
        """A message has come."""
        self._times_s.append(time_s)

    def fault(self, time_s: float) -> str | None:
        """The fault of the stream, for people; None if it has none."""
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
