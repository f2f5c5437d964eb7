"""The kernel's strips of joint space: the one that lies along the longest way between some points."""

from __future__ import annotations

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array


@compiled
def strip_around(points: Array) -> tuple[Array, Array, Array]:
    """Middle, direction and deviation, each (n,), of a strip that holds the hull of `points` (k, n) [rad or m].

    It lies between the two points that are farthest from one another in the joint in which any are.
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
    middle, direction, deviation = np.empty(joints), np.empty(joints), np.zeros(joints)
    square = 0.0
    for joint in range(joints):
        middle[joint] = (points[start, joint] + points[end, joint]) / 2.0
        direction[joint] = (points[end, joint] - points[start, joint]) / 2.0
        square += direction[joint] * direction[joint]
    if square == 0.0:
        return middle, direction, deviation
    low_aside, high_aside = np.full(joints, np.inf), np.full(joints, -np.inf)
    for k in range(count):
        t = 0.0
        for joint in range(joints):
            t += (points[k, joint] - middle[joint]) * direction[joint]
        t = min(max(t / square, -1.0), 1.0)
        for joint in range(joints):
            aside = points[k, joint] - middle[joint] - t * direction[joint]
            low_aside[joint] = min(low_aside[joint], aside)
            high_aside[joint] = max(high_aside[joint], aside)
    for joint in range(joints):
        middle[joint] += (low_aside[joint] + high_aside[joint]) / 2.0
        deviation[joint] = (high_aside[joint] - low_aside[joint]) / 2.0
    return middle, direction, deviation
