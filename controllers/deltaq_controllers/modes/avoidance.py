"""Keep redundant joints off their limits: the weights of a motion, and a drift in the null space of the hands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.redundancy import limit_gradient
from deltaq_protocol.arrays import Array

WEIGHT_SCALE = 0.02
"""Scale of the limit weights: a joint at 90 % of its range moves a fifth of what a free one does."""


LEAST_WEIGHT = 0.01
"""Least weight of a joint, at its limit: it must be able to leave."""

MARGIN = 2e-4
"""Part of a joint's range, at either end, into which redundancy does not move it."""


def limit_weights(q: Array, lower: Array, upper: Array) -> Array:
    """(n,) diagonal of W^-1: 1 in the middle of each range, `LEAST_WEIGHT` at its ends.

    The weights of Chan & Dubey with the gradient made dimensionless by the range of the joint, so that
    rad and m mix. They are not one-sided: a weight that jumps with the sign of a rate would make an increment jump.
    """
    gradient = limit_gradient(q, lower, upper) * (upper - lower)
    weights: Array = np.maximum(1.0 / (1.0 + (WEIGHT_SCALE * gradient) ** 2), LEAST_WEIGHT)
    return weights


def moves_out(q: Array, displacement: Array, lower: Array, upper: Array) -> NDArray[np.bool_]:
    """(n,) which joints a displacement (n,) takes into the margin at their limits, or farther into it."""
    margin = MARGIN * (upper - lower)
    # twice: room for the brake
    end = q + 2.0 * displacement
    out: NDArray[np.bool_] = ((displacement > 0.0) & (end > upper - margin)) | (
        (displacement < 0.0) & (end < lower + margin)
    )
    return out


def travel(q: Array, lower: Array, upper: Array) -> float:
    """Joint travel criterion (Hooper & Noakes, Table 2, constraint): 0 with all joints in the middle, 1 at the ends.

    `sum(((q - middle) / half)^2) / n`, dimensionless.
    """
    return float(np.mean(((2.0 * q - lower - upper) / (upper - lower)) ** 2))


def travel_gradient(q: Array, lower: Array, upper: Array) -> Array:
    """(n,) gradient of `travel` [1/rad or 1/m]."""
    gradient: Array = 4.0 * (2.0 * q - lower - upper) / (upper - lower) ** 2 / len(q)
    return gradient
