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
