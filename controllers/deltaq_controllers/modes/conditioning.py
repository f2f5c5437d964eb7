"""Conditioning of the tasks along the commanded direction, and the greatest speed towards a singularity.

The measure is the mobility along the commanded direction, on the plain Jacobian: the travel of the tasks for each rad
of the least joint motion,

    mobility = |w| / |J^+ w|

A joint near its limit is no singularity, and a singularity whose lost direction is not commanded does not matter.
Where the mobility falls along the direction, the rest of it is braking distance, as before a joint's limit: with the
motion of the joints tau, its unit vector u and their greatest common deceleration a along it,

    tau' <= sqrt(2 a (mobility - LEAST) / -d mobility / d tau)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array

LENGTH_M = 0.5
"""Travel that a turn of 1 rad counts as [m/rad]."""

LEAST_M = 0.02
"""Mobility at which the motion ends [m/rad]."""

WATCHED_M = 0.5
"""Mobility below which it is asked how it changes [m/rad]."""

LEADS_OUT = 0.05
"""Rise of the mobility along a way that leads out of a singularity [m/rad^2]."""

LOST = 1e-2
"""Part of a way that no joint motion makes, beyond which it is lost altogether."""

BRAKE_SHARE = 0.4
"""Part of the joints' deceleration that the approach to a singularity counts on."""

GLANCE = 1e-3
"""Joint motion ahead at which the mobility is looked at [rad or m]."""

_DAMPING = 1e-9
"""Added to the diagonal of J W J^T: a singularity's own direction is not to be divided by zero [m^2]."""


class Motions(NamedTuple):
    """The least joint motions that achieve the requested motion, and the motion that is made.

    Attributes:
        asked: (n,) requested increment [rad or m].
        made: (n,) increment that is made [rad or m].
        mobility: in the requested direction; infinite without a request [m/rad].
        lost: part of it that no joint motion makes.
    """

    asked: Array
    made: Array
    mobility: float
    lost: float


@compiled
def least_motions(rows: Array, shares: Array, asked: Array, made: Array) -> Motions:
    """Joint motions of the least weighted size.

    Args:
        rows: (r, n) displacement of each task per joint displacement, turns as travel.
        shares: (n,) of a joint in the work, the inverse of its weight.
        asked: (r,) rates of the tasks that are asked for.
        made: (r,) rates of the tasks that are made.
    """
    tasks, n = rows.shape
    square = np.empty((tasks, tasks))
    for i in range(tasks):
        for j in range(i + 1):
            total = 0.0
            for joint in range(n):
                total += rows[i, joint] * shares[joint] * rows[j, joint]
            square[i, j] = square[j, i] = total
        square[i, i] += _DAMPING
    # Cholesky's factor in the lower triangle
    for i in range(tasks):
        for j in range(i + 1):
            total = square[i, j]
            for k in range(j):
                total -= square[i, k] * square[j, k]
            square[i, j] = math.sqrt(max(total, 1e-3 * _DAMPING)) if i == j else total / square[j, j]
    motion, going = _applied(square, rows, shares, asked), _applied(square, rows, shares, made)
    size = math.sqrt((motion * motion).sum())
    way = math.sqrt((asked * asked).sum())
    missing = 0.0
    for i in range(tasks):
        missing += (asked[i] - (rows[i] * motion).sum()) ** 2
    if way == 0.0:
        return Motions(motion, going, math.inf, 0.0)
    return Motions(motion, going, way / max(size, 1e-12), math.sqrt(missing) / way)


@compiled
def _applied(factor: Array, rows: Array, shares: Array, right: Array) -> Array:
    """(n,) joint motion of the rates `right` (r,), by the Cholesky factor (r, r)."""
    x = right.copy()
    for i in range(len(x)):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(len(x) - 1, -1, -1):
        for k in range(i + 1, len(x)):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]
    motion = np.zeros(rows.shape[1])
    for i in range(len(x)):
        motion += x[i] * rows[i]
    return motion * shares


@compiled
def kept_share(motion: Array, mobility: float, ahead: float, max_acceleration: Array) -> float:
    """The fraction of the requested rates from which the robot can stop before the mobility is used up.

    Args:
        motion: (n,) joint rates that do it [rad/s or m/s].
        mobility: of it [m/rad].
        ahead: mobility `GLANCE` further along it.
        max_acceleration: (n,) of the joints [rad/s^2 or m/s^2].
    """
    fall = (mobility - ahead) / GLANCE
    if mobility < LEAST_M:
        # out again, but not along it
        return 1.0 if fall < -LEADS_OUT else 0.0
    if fall <= 0.0:
        return 1.0
    size = math.sqrt((motion * motion).sum())
    deceleration = BRAKE_SHARE / (np.abs(motion) / max_acceleration).max() * size
    room = max(mobility - LEAST_M, 0.0) / fall
    return min(1.0, math.sqrt(2.0 * deceleration * room) / size)


@compiled
def ramp_share(bend: Array, change: Array, most: Array, max_jerk: Array) -> float:
    """The largest share of a change that one cycle may make: of joint increments, `|bend + share change| <= most`.

    If the path's curvature or a brake needs more than that, the least share that returns to the bound is used.

    Args:
        bend: (n,) change of the increments at constant task rates.
        change: (n,) change of the increments that takes up the whole change of the tasks.
        most: (n,) that one cycle may make.
        max_jerk: (n,) of the increments; the rest of the change ends without a jerk.
    """
    least, largest = 0.0, 1.0
    for joint in range(len(change)):
        size = change[joint]
        if abs(size) < 1e-15:
            continue
        bound, jerk = most[joint], max_jerk[joint]
        if jerk < math.inf:
            # a change that falls by the jerk in each cycle adds up to no more than what is left
            left = abs(bend[joint] + size)
            bound = min(bound, math.sqrt(0.25 * jerk * jerk + 2.0 * jerk * left) - 0.5 * jerk)
        one, other = (bound - bend[joint]) / size, (-bound - bend[joint]) / size
        least, largest = max(least, min(one, other)), min(largest, max(one, other))
    return min(max(least, largest, 0.0), 1.0)


class Ramped(NamedTuple):
    """What one cycle makes of a change of the tasks.

    Attributes:
        rates: (r,) of the tasks [m/s].
        motion: (n,) of the joints that do it with the least motion [rad/s or m/s].
    """

    rates: Array
    motion: Array


@compiled
def ramped(
    motions: Motions,
    before: Array,
    asked: Array,
    made: Array,
    share: float,
    most: Array,
    max_jerk: Array,
    cycle_s: float,
) -> Ramped:
    """The tasks' rates, as near to the commanded ones as one cycle allows (`ramp_share`).

    Args:
        motions: of the joints.
        before: (n,) joint motion of the cycle before [rad/s or m/s].
        asked: (r,) commanded rates [m/s].
        made: (r,) present rates [m/s].
        share: allowed part of the commanded rates.
        most: (n,) largest change of the increments in a cycle [rad or m].
        max_jerk: (n,) of the increments [rad or m].
        cycle_s: the cycle [s].
    """
    change = share * motions.asked - motions.made
    ramp = ramp_share(cycle_s * (motions.made - before), cycle_s * change, most, max_jerk)
    return Ramped(made + ramp * (share * asked - made), motions.made + ramp * change)
