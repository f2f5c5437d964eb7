"""Rows of `deltaq bench`: a figure, its reference of the same run, and the bound of their ratio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel


class BenchRow(BaseModel, frozen=True):
    """One figure beside its reference.

    Each ratio is one by one: median by median, p99 by p99, p99.9 by p99.9, longest by longest.

    Attributes:
        kept: whether every bound is kept; None without bounds.
    """

    what: str
    reference: str
    median_us: float
    reference_us: float
    median_ratio: float
    p99_ratio: float
    p99_9_ratio: float
    longest_ratio: float
    at_most: float | None = None
    """Bound of the median ratio; None, here and below: no bound."""
    p99_at_most: float | None = None
    p99_9_at_most: float | None = None
    longest_at_most: float | None = None
    kept: bool | None = None

    @classmethod
    def of(
        cls,
        what: str,
        reference: str,
        seconds: Sequence[float],
        references: Sequence[float],
        **bounds: float,
    ) -> BenchRow:
        """The row of two series of times [s], neither of them empty; `bounds` are the fields `..._at_most`."""

        def ratio(percent: float) -> float:
            return float(np.percentile(seconds, percent)) / float(np.percentile(references, percent))

        row = cls(
            what=what,
            reference=reference,
            median_us=float(np.median(seconds)) * 1e6,
            reference_us=float(np.median(references)) * 1e6,
            median_ratio=ratio(50.0),
            p99_ratio=ratio(99.0),
            p99_9_ratio=ratio(99.9),
            longest_ratio=ratio(100.0),
            **bounds,
        )
        promised = row.bounds.values()
        kept = all(found <= bound for found, bound in promised) if promised else None
        return row.model_copy(update={"kept": kept})

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Ratio and bound of each bounded figure, by its name."""
        named = {
            "median": (self.median_ratio, self.at_most),
            "p99": (self.p99_ratio, self.p99_at_most),
            "p99.9": (self.p99_9_ratio, self.p99_9_at_most),
            "longest": (self.longest_ratio, self.longest_at_most),
        }
        return {name: (ratio, bound) for name, (ratio, bound) in named.items() if bound is not None}


class BenchTable(BaseModel, frozen=True):
    """All figures of one run."""

    rows: tuple[BenchRow, ...]

    @property
    def good(self) -> bool:
        """Whether every bound is kept."""
        return all(row.kept is not False for row in self.rows)
