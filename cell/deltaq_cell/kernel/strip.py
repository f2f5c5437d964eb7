"""The kernel's strips of joint space: the one that lies along the longest way between some points."""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.compiled import compiled, makes_no_array
from deltaq_protocol.arrays import Array


@compiled
def strip_around(points: Array) -> tuple[Array, Array, Array]:
    """Middle, direction and deviation, each (n,), of a strip that holds the hull of `points` (k, n) [rad or m]."""
    joints = points.shape[1]
    middle, direction, deviation = np.empty(joints), np.empty(joints), np.empty(joints)
    write_strip(points, middle, direction, deviation, np.empty((2, joints)))
    return middle, direction, deviation


@makes_no_array
def write_strip(points: Array, middle: Array, direction: Array, deviation: Array, aside: Array) -> None:
    """Write a strip that holds the hull of `points` (k, n) [rad or m].

    It lies between the two points that are farthest from one another in the joint in which any are.

    Args:
        points: to be held.
        middle: at least (n,), is written to.
        direction: at least (n,), is written to.
        deviation: at least (n,), is written to.
        aside: at least (2, n), is written to.
    """
    count, joints = points.shape
    start = end = 0
    widest = -1.0
    for joint in range(joints):
        low = high = 0
        for k in range(1, count):
            if points[k, joint] < points[low, joint]:
                low = k
            if points[k, joint] > points[high, joint]:
                high = k
        if points[high, joint] - points[low, joint] > widest:
            widest, start, end = points[high, joint] - points[low, joint], low, high
    square = 0.0
    for joint in range(joints):
        middle[joint] = (points[start, joint] + points[end, joint]) / 2.0
        direction[joint] = (points[end, joint] - points[start, joint]) / 2.0
        deviation[joint] = 0.0
        aside[0, joint], aside[1, joint] = math.inf, -math.inf
        square += direction[joint] * direction[joint]
    if square == 0.0:
        return
    for k in range(count):
        t = 0.0
        for joint in range(joints):
            t += (points[k, joint] - middle[joint]) * direction[joint]
        t = min(max(t / square, -1.0), 1.0)
        for joint in range(joints):
            off = points[k, joint] - middle[joint] - t * direction[joint]
            aside[0, joint] = min(aside[0, joint], off)
            aside[1, joint] = max(aside[1, joint], off)
    for joint in range(joints):
        middle[joint] += (aside[0, joint] + aside[1, joint]) / 2.0
        deviation[joint] = (aside[1, joint] - aside[0, joint]) / 2.0
