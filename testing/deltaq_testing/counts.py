"""Counts that a run reports: verdicts by outcome, and cycles beyond a limit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict


class LimitCounts(BaseModel):
    """How many joints of how many cycles were beyond a limit."""

    model_config = ConfigDict(frozen=True)

    position_violations: int = 0
    velocity_violations: int = 0
    acceleration_violations: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.position_violations + self.velocity_violations + self.acceleration_violations

    @classmethod
    def sum(cls, counts: Iterable[LimitCounts]) -> LimitCounts:
        """Those of several robots or runs together."""
        return cls(**_added(counts))


class GateCounts(BaseModel):
    """Verdicts by outcome."""

    model_config = ConfigDict(frozen=True)

    admitted: int = 0
    scaled: int = 0
    held: int = 0
    refused: int = 0

    @classmethod
    def sum(cls, counts: Iterable[GateCounts]) -> GateCounts:
        """Those of several runs together."""
        return cls(**_added(counts))

    @classmethod
    def of(cls, counts: dict[str, int]) -> GateCounts:
        """From a counter that may hold other counts as well."""
        return cls(**{name: counts.get(name, 0) for name in cls.model_fields})


def _added(counts: Iterable[BaseModel]) -> dict[str, int]:
    together: Counter[str] = Counter()
    for count in counts:
        together.update(count.model_dump())
    return dict(together)
