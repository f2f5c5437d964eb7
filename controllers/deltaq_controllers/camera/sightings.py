"""How well the leader was seen in a run: the cycles of each sight, and when it changed."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any

from deltaq_protocol.messages import Sight

MOST_CHANGES = 100
"""Changes that are remembered, the newest."""


class Sightings:
    """Counts of a follower's sight of its leader."""

    def __init__(self) -> None:
        self._cycles: Counter[Sight] = Counter()
        self._sight: Sight | None = None
        self._changes: deque[dict[str, Any]] = deque(maxlen=MOST_CHANGES)

    def add(self, sight: Sight, age_s: float, time_s: float) -> bool:
        """Count a cycle; True if the sight of the leader has changed. A first view that is fresh is no change.

        Args:
            sight: how well the leader is seen.
            age_s: of its state [s].
            time_s: stamp of the own robot's state [s].
        """
        self._cycles[sight] += 1
        before, self._sight = self._sight, sight
        if sight is before or (before is None and sight is Sight.FRESH):
            return False
        self._changes.append({"time_s": time_s, "sight": sight.value, "age_s": age_s})
        return True

    def summary(self) -> dict[str, Any]:
        """Cycles of each sight, and the newest changes, as a JSON object."""
        return {**{sight.value: self._cycles[sight] for sight in Sight}, "changes": list(self._changes)}
