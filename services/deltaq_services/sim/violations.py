"""Violations: pairs of bodies that are nearer than the stop distance, and how near each of them may stay.

A violation has a cause outside the gate: no admission leads into one. The distance at its beginning, measured while
the robots concerned stood still, is kept until it has ended. A weaker rule would not do: a gate that compared with
the cycle before, with a tolerance for rounding, would let a robot creep into contact, a micrometre at a time.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from deltaq_protocol.guarded import KeptDistance

BodyPair = frozenset[str]
"""Names of two bodies."""

ALLOWANCE_M = 5e-6
"""How much nearer a pair may come in all while its violation lasts: only as much as rounding needs."""

_MEASURED_M = 2e-6
"""Largest difference of the same distance when it is measured again."""


class Violations:
    """The distances that violated pairs have to keep [m]."""

    def __init__(self) -> None:
        self._kept: dict[BodyPair, float] = {}

    def kept_m(self, pair: BodyPair) -> float | None:
        """The distance that a pair has to keep; None if it is not known to be violated."""
        return self._kept.get(pair)

    def stands(self, pair: BodyPair, distance_m: float, stop_distance_m: float) -> None:
        """A pair nearer than its stop distance was measured while its robots stood still.

        Args:
            pair: names of the bodies.
            distance_m: at the setpoints.
            stop_distance_m: what the pair keeps otherwise.
        """
        keeps = min(distance_m - ALLOWANCE_M, stop_distance_m)
        before = self._kept.get(pair)
        # no admission can have brought it nearer than it had to keep: somebody else did
        if before is None or distance_m < before - _MEASURED_M:
            self._kept[pair] = keeps

    def only(self, robot: str, violated: Collection[BodyPair]) -> None:
        """The violations of a robot are among these; all others of it have ended."""
        ended = [pair for pair in self._kept if _concerns(pair, robot) and pair not in violated]
        for pair in ended:
            del self._kept[pair]

    def snapshot(self) -> tuple[KeptDistance, ...]:
        """Snapshot for `restore`."""
        return tuple(
            KeptDistance(pair=(one, other), distance_m=distance)
            for (one, other), distance in sorted((sorted(pair), item) for pair, item in self._kept.items())
        )

    def restore(self, memory: Iterable[KeptDistance]) -> None:
        """Restore a snapshot of another gate."""
        self._kept = {frozenset(item.pair): item.distance_m for item in memory}


def _concerns(pair: BodyPair, robot: str) -> bool:
    return any(name.startswith(f"{robot}/") for name in pair)
