"""The weighted gradient solution: joint rates from a task rate and a sub-task field.

Bjerkeng et al., III-B and III-C. Differences from the print, see the errata:

- (10) takes an explicit scale, `W_ii = 1 + (limit_scale H_i)^2`: H has the unit 1/angle, so that as printed
  the weights depend on the unit of angle. pi/180 gives the same as degrees.
- A joint that moves away from its limit has weight 1, as III-B says of Chan and Dubey's rule and (10) omits.
- (7) is damped: near limits `J W^-1 J^T` loses rank.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array

LIMIT_GUARD = 1e-3
"""Nearer to a limit than this fraction of the joint's range, (11) is evaluated at this distance."""

_MATTERS = 1e-2
"""A weight that exceeds 1 by less is not worth a second solution."""


@compiled
def limit_gradient(q: Array, lower: Array, upper: Array) -> Array:
    """H of (11): positive in the upper half of each range; a guard keeps it finite at the limits.

    Args:
        q: (n,) configuration.
        lower: (n,) lower limits.
        upper: (n,) upper limits.

    Returns:
        (n,) gradient [1/rad or 1/m].
    """
    span = upper - lower
    guard = LIMIT_GUARD * span
    above = np.maximum(q - lower, guard)
    below = np.maximum(upper - q, guard)
    gradient: Array = (span / (above * below)) ** 2 * (above - below)
    return gradient


@compiled
def damped_rates(jacobian: Array, inverse_weights: Array, task: Array, field: Array, damping: float) -> Array:
    """The law (9) for given weights.

    With `g = W^-1 F` the law is `g + W^-1 J^T (J W^-1 J^T + damping I)^-1 (task - J g)`.

    Args:
        jacobian: (2, n) task Jacobian.
        inverse_weights: (n,) diagonal of W^-1.
        task: (2,) wanted task rate.
        field: (n,) sub-task field F.
        damping: added to the diagonal of `J W^-1 J^T`, in its unit.

    Returns:
        (n,) joint rates.
    """
    a = b = c = d0 = d1 = 0.0
    for i in range(len(field)):
        weighted0, weighted1 = inverse_weights[i] * jacobian[0, i], inverse_weights[i] * jacobian[1, i]
        a += weighted0 * jacobian[0, i]
        b += weighted0 * jacobian[1, i]
        c += weighted1 * jacobian[1, i]
        d0 += weighted0 * field[i]
        d1 += weighted1 * field[i]
    a, c = a + damping, c + damping
    r0, r1 = task[0] - d0, task[1] - d1
    determinant = a * c - b * b
    x0, x1 = (c * r0 - b * r1) / determinant, (a * r1 - b * r0) / determinant
    rates: Array = inverse_weights * (x0 * jacobian[0] + x1 * jacobian[1] + field)
    return rates


class WeightedGradient(NamedTuple):
    """The law (9) with limits of the joints.

    Attributes:
        lower: (n,) lower limits [rad or m].
        upper: (n,) upper limits [rad or m].
        limit_scale: `s_w` of the weights [rad or m].
        damping: singular value at which the damping halves the task rate, as a ratio of view angle to
            joint angle.
    """

    lower: Array
    upper: Array
    limit_scale: float
    damping: float


@compiled
def inverse_weights(weights: WeightedGradient, q: Array, rates: Array) -> Array:
    """(n,) diagonal of W^-1; 1 for joints that `rates` (n,) moves away from their nearer limit."""
    gradient = limit_gradient(q, weights.lower, weights.upper)
    weighed = 1.0 / (1.0 + (weights.limit_scale * gradient) ** 2)
    return np.where(gradient * rates < 0.0, 1.0, weighed)


@compiled
def weighted_rates(
    weights: WeightedGradient, q: Array, jacobian: Array, task: Array, field: Array, stretch: float
) -> Array:
    """Joint rates of (9), every joint that approaches a limit weighed.

    The weights depend on the rates and the rates on the weights. Joints that leave their limit with all weights
    applied are released; those that then reverse are weighted again, until none does.

    Args:
        weights: the joints' weights.
        q: (n,) configuration [rad or m].
        jacobian: (2, n) task Jacobian.
        task: (2,) wanted task rate [1/s].
        field: (n,) sub-task field [rad/s or m/s].
        stretch: singular values of the task by the view angle, to give the damping its unit.

    Returns:
        (n,) joint rates [rad/s or m/s].
    """
    damping = (weights.damping * stretch) ** 2
    gradient = limit_gradient(q, weights.lower, weights.upper)
    weighed = 1.0 / (1.0 + (weights.limit_scale * gradient) ** 2)
    rates = damped_rates(jacobian, weighed, task, field, damping)
    released = (gradient * rates < 0.0) & (weighed < 1.0 - _MATTERS)
    count = released.sum()
    while count:
        rates = damped_rates(jacobian, np.where(released, 1.0, weighed), task, field, damping)
        released &= gradient * rates < 0.0
        kept = released.sum()
        if kept == count:
            break
        count = kept
        if not count:
            rates = damped_rates(jacobian, weighed, task, field, damping)
    return rates


@compiled
def emergency_rates(weights: WeightedGradient, q: Array, repulsion: Array) -> Array:
    """The pure obstacle avoidance (13), with one-sided weights so that limits do not hold an evasion back.

    Args:
        weights: the joints' weights.
        q: (n,) configuration [rad or m].
        repulsion: (n,) F_rep [rad/s or m/s].

    Returns:
        (n,) joint rates [rad/s or m/s].
    """
    return inverse_weights(weights, q, repulsion) * repulsion


class Emergency:
    """Whether the camera task is given up for obstacle avoidance; on and off at different distances.

    Args:
        on_m: clearance below which the camera task is given up [m].
        off_m: clearance above which it is resumed [m].
    """

    def __init__(self, on_m: float, off_m: float) -> None:
        self._on_m, self._off_m = on_m, off_m
        self.active = False

    def update(self, clearance_m: float) -> bool:
        """Update with the clearance [m]; True while the camera task is given up."""
        self.active = clearance_m < (self._off_m if self.active else self._on_m)
        return self.active


DEGREES = math.pi / 180.0
"""The `limit_scale` with which (10) gives the paper's values, whose angles are in degrees [rad]."""
