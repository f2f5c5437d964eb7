"""Vectors of a few numbers, for compiled functions: numpy's operations cost more there than the arithmetic."""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array


@compiled
def cross(a: Array, b: Array) -> Array:
    """(3,) a x b."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@compiled
def distance(a: Array, b: Array) -> float:
    """|a - b| of points (3,) [m]."""
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@compiled
def components(rotation: Array, v: Array) -> Array:
    """(3,) `rotation^T v`: a vector of the world in a frame whose axes are the columns of `rotation` (3, 3)."""
    parts: Array = v[0] * rotation[0] + v[1] * rotation[1] + v[2] * rotation[2]
    return parts


@compiled
def turn_between(one: Array, other: Array) -> tuple[float, float, float]:
    """The rotation vector, in world axes, that turns axes (3, 3) to others; of larger matrices 3 x 3 count [rad]."""
    x = y = z = trace = 0.0
    for k in range(3):
        x += 0.5 * (one[1, k] * other[2, k] - one[2, k] * other[1, k])
        y += 0.5 * (one[2, k] * other[0, k] - one[0, k] * other[2, k])
        z += 0.5 * (one[0, k] * other[1, k] - one[1, k] * other[0, k])
        trace += one[0, k] * other[0, k] + one[1, k] * other[1, k] + one[2, k] * other[2, k]
    sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, 0.5 * (trace - 1.0))
    if sine > 1e-9:
        return x * angle / sine, y * angle / sine, z * angle / sine
    # none, or half a turn about an axis that rounding hides: any axis leads away from there
    return (x, y, z) if angle < 1.0 else (angle, 0.0, 0.0)


@compiled
def solved(square: Array, right: Array) -> Array:
    """(m,) x of `square x = right` for a few equations; `square` (m, m) is symmetric and positive definite."""
    left, x = square.copy(), right.copy()
    for pivot in range(len(x)):
        for row in range(pivot + 1, len(x)):
            share = left[row, pivot] / left[pivot, pivot]
            left[row] -= share * left[pivot]
            x[row] -= share * x[pivot]
    for row in range(len(x) - 1, -1, -1):
        for column in range(row + 1, len(x)):
            x[row] -= left[row, column] * x[column]
        x[row] /= left[row, row]
    return x
