"""How regularly messages come: pure arithmetic on arrival times."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Regularity:
    """Regularity of one stream.

    Attributes:
        count: messages that came.
        rate_hz: mean rate, None before the second message.
        period_median_s: median time between two messages.
        period_p99_s: 99th percentile of it.
        period_max_s: longest of it.
    """

    count: int
    rate_hz: float | None
    period_median_s: float | None
    period_p99_s: float | None
    period_max_s: float | None


def rate_of(times_s: list[float]) -> Regularity:
    """Regularity of messages that came at `times_s`, in order [s]."""
    if len(times_s) < 2:
        return Regularity(len(times_s), None, None, None, None)
    periods = sorted(after - before for before, after in itertools.pairwise(times_s))
    span = times_s[-1] - times_s[0]
    return Regularity(
        count=len(times_s),
        rate_hz=len(periods) / span if span > 0 else None,
        period_median_s=percentile(periods, 0.5),
        period_p99_s=percentile(periods, 0.99),
        period_max_s=periods[-1],
    )


def percentile(ordered: list[float], share: float) -> float:
    """The value that a fraction `share` of all values do not exceed, by nearest rank; `ordered` is not empty."""
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
