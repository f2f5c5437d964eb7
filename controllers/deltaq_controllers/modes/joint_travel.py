"""Joint travel: how far the joints are from the middle of their ranges (Hooper & Noakes, Table 2, constraint)."""

from __future__ import annotations

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array


def travel(q: Array, lower: Array, upper: Array) -> float:
    """0 with all joints in the middle of their ranges, 1 at the ends: `sum(((q - middle) / half)^2) / n`."""
    return float(np.mean(((2.0 * q - lower - upper) / (upper - lower)) ** 2))


@compiled
def travel_gradient(q: Array, lower: Array, upper: Array) -> Array:
    """(n,) gradient of `travel` [1/rad or 1/m]."""
    gradient = np.empty_like(q)
    for joint in range(len(q)):
        width = upper[joint] - lower[joint]
        gradient[joint] = 4.0 * (2.0 * q[joint] - lower[joint] - upper[joint]) / width**2 / len(q)
    return gradient
