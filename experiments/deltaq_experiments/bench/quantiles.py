"""Ages and durations as p50, p99, p99.9 and the longest."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict


class Quantiles(BaseModel):
    """A distribution in four figures, by nearest rank; all None where nothing was measured.

    Attributes:
        count: how many were measured.
        p50: the value that half of them do not exceed.
        p99: the value that 99 % of them do not exceed.
        p99_9: the value that 99.9 % of them do not exceed; with fewer than a thousand it is the longest.
        longest: the greatest of them.
    """

    model_config = ConfigDict(frozen=True)

    count: int
    p50: float | None
    p99: float | None
    p99_9: float | None
    longest: float | None

    @classmethod
    def of(cls, values: Sequence[float]) -> Quantiles:
        """Of values in any order; the figures have their unit."""
        if not values:
            return cls(count=0, p50=None, p99=None, p99_9=None, longest=None)
        ordered = sorted(values)

        def rank(per_mille: int) -> float:
            # whole numbers: 0.999 * 1000 is not 999 in every rounding
            return ordered[max(0, math.ceil(per_mille * len(ordered) / 1000) - 1)]

        return cls(count=len(ordered), p50=rank(500), p99=rank(990), p99_9=rank(999), longest=ordered[-1])


def ratio(value: float | None, reference: float | None) -> float | None:
    """One figure as a multiple of another; None where either is missing, or the reference is nothing."""
    if value is None or reference is None or reference <= 0.0:
        return None
    return value / reference
