"""Increments that come over zenoh, sifted before the loop hears of them: whose they are, and how many there may be.

It works in zenoh's threads. A stranger's increments cost one MAC each: they do not wake the loop, nobody decodes them,
and they take no holder's place in a queue.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

import zenoh

from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.flood_wait import FloodWait
from deltaq_services.rate_limit import RateLimit

MOST_A_CYCLE = 4
"""Increments of a holder that are judged, on average: one is passed on, the rest is replaced by newer ones."""
MOST_ENDED_S = 5.0
"""Increments a second of one who has lost the lease that are answered; each answer goes to every watcher."""


MOST_UNPROVEN_S = 100.0
"""Increments a second that show no lease and are read as fast as they come; no client sends any."""


class Sifted(NamedTuple):
    """An increment as it came, for which robot, and the token of the lease that it was proven to be sent under."""

    robot: str
    token: str
    payload: bytes


class Sieve:
    """Keeps increments that nobody proves, or that are too many, from the loop.

    Args:
        keys: zenoh key of each robot's increments, by robot.
        cycle_s: of the robots.
        authentication: knows proofs.
        now: monotonic time [s].
    """

    def __init__(
        self,
        keys: Mapping[str, str],
        cycle_s: float,
        authentication: Authentication,
        now: Callable[[], float],
    ) -> None:
        self._robots = {key: robot for robot, key in keys.items()}
        self._authentication = authentication
        self._now = now
        self._rates = {robot: RateLimit(MOST_A_CYCLE / cycle_s) for robot in keys}
        self._ended_rates = {robot: RateLimit(MOST_ENDED_S) for robot in keys}
        self._flood_wait = FloodWait(MOST_UNPROVEN_S)
        self._lock = threading.Lock()
        self._counters: Counter[str] = Counter()

    def sift(self, sample: zenoh.Sample) -> Sifted | None:
        """An increment that the loop shall hear of; None: it is counted and forgotten."""
        key = str(sample.key_expr)
        robot, proof = self._robots.get(key), sample.attachment
        if robot is None or proof is None:
            self._count_unproven()
            return None
        payload = sample.payload.to_bytes()
        proven = self._authentication.holder_of_increment(robot, key, payload, proof.to_bytes())
        if proven is None:
            self._count_unproven()
            return None
        rates = self._rates if proven.is_present else self._ended_rates
        with self._lock:
            if not rates[robot].take(self._now()):
                self._counters["increments_too_many"] += 1
                return None
        return Sifted(robot, proven.token, payload)

    @property
    def unproven(self) -> int:
        """Increments that nobody proved."""
        return self._counters["increments_unproven"]

    def counters(self) -> Counter[str]:
        """What was forgotten."""
        with self._lock:
            return self._counters.copy()

    def _count_unproven(self) -> None:
        with self._lock:
            self._counters["increments_unproven"] += 1
        self._flood_wait.one_more()
