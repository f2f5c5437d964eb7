"""Increments that come over zenoh, sifted before the loop hears of them: whose they are, and how many there may be.

It works in zenoh's threads. A stranger's increments cost one MAC each: they do not wake the loop, nobody decodes them,
and they take no holder's place in a queue.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

import msgpack
import zenoh

from deltaq_protocol.codec import MAX_MESSAGE_BYTES
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.flood_wait import FloodWait
from deltaq_services.hli.sequence import Sequence
from deltaq_services.rate_limit import RateLimit

MOST_A_CYCLE = 4
"""Increments of a holder that are judged, on average: one is passed on, the rest is replaced by newer ones."""
MOST_RARE_S = 5.0
"""Increments a second that are answered of one who has lost the lease, and of those that come again or name no number.
Each answer goes to every watcher. Whoever has overheard an increment can send it again: it takes nothing of the rate
that its holder has."""
MOST_UNPROVEN_S = 100.0
"""Increments a second that show no lease, or are too many, and are read as fast as they come; no client sends any."""
_TOLD_APART = 1024
"""Newest sequence numbers of a lease; a playout buffer's are fewer."""


class Sifted(NamedTuple):
    """An increment as it came, for which robot, and the token of the lease that it was proven to be sent under."""

    robot: str
    token: str
    payload: bytes


class Sieve:
    """Keeps increments without a proof, and increments that are too many, from the loop.

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
        self._rare_rates = {robot: RateLimit(MOST_RARE_S) for robot in keys}
        self._seen: dict[str, tuple[str, Sequence]] = {}
        self._flood_wait = FloodWait(MOST_UNPROVEN_S)
        self._lock = threading.Lock()
        self._counters: Counter[str] = Counter()

    def sift(self, sample: zenoh.Sample) -> Sifted | None:
        """An increment to pass on to the loop; None: it is counted and dropped."""
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
        seq = _seq_in(payload)
        with self._lock:
            is_new = proven.is_present and self._is_new(robot, proven.token, seq)
            rates = self._rates if is_new else self._rare_rates
            if rates[robot].take(self._now()):
                return Sifted(robot, proven.token, payload)
            self._counters["increments_too_many"] += 1
        self._flood_wait.one_more()
        return None

    @property
    def unproven(self) -> int:
        """Number of increments without a valid proof."""
        return self._counters["increments_unproven"]

    def counters(self) -> Counter[str]:
        """Counts of increments that were not passed on."""
        with self._lock:
            return self._counters.copy()

    def _is_new(self, robot: str, token: str, seq: int | None) -> bool:
        """Whether a sequence number was not seen yet under the present lease."""
        if seq is None:
            return False
        known, sequence = self._seen.get(robot, ("", Sequence()))
        if known != token:
            sequence = Sequence(_TOLD_APART)
            self._seen[robot] = token, sequence
        return sequence.take(seq)

    def _count_unproven(self) -> None:
        with self._lock:
            self._counters["increments_unproven"] += 1
        self._flood_wait.one_more()


def _seq_in(payload: bytes) -> int | None:
    """The sequence number of an increment, which the loop is to decode; None if it has none."""
    if len(payload) > MAX_MESSAGE_BYTES:
        return None
    try:
        seq = msgpack.unpackb(payload)["seq"]
    except Exception:  # what a holder makes up raises many unrelated types
        return None
    return seq if type(seq) is int and seq >= 0 else None
