"""Spans of joint space: the hull of a few setpoints of a course, widened until it holds all others.

Drives are not exactly in the hull of their setpoints. `beside` bounds how far a joint may be beside it, and `off_hull`
tells how far a measured robot is.
"""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.compiled import compiled, inlined, makes_no_array
from deltaq_cell.kernel.arrays import Integers
from deltaq_protocol.arrays import Array

VERTICES = 4
"""Of a span at most."""

_SEARCH_STEPS = 2000
"""Of a search for the nearest point of a hull; where drives follow it ends after a few."""

_NEAREST = 1e-6
"""The search ends where no point of the hull can be nearer by more than this, in squares of the width."""

SHORTEST = 1e-7
"""What no drive resolves [rad or m]: what lies no farther beside a span gets no vertex, and is not divided."""


@compiled
def span_around(points: Array) -> tuple[Array, Array, Array, Array]:
    """A span that holds the hull of `points` (k, n), in the order of their course [rad or m].

    Returns:
        Middle and half-widths, each (n,), of the box around the points; offsets (vertices, n) of the span's vertices
        from that middle, and its deviation (n,).
    """
    joints = points.shape[1]
    middle, half = np.empty(joints), np.empty(joints)
    write_box(points, middle, half)
    offset, deviation = np.empty((VERTICES, joints)), np.empty(joints)
    kept, beside = np.empty((2, VERTICES), dtype=np.int64), np.empty(VERTICES)
    vertices = write_span(points, middle, offset, deviation, kept, beside, np.empty((2, joints)))
    return middle, half, offset[:vertices].copy(), deviation


@inlined
def beside(points: Array, joint: int, tolerance: Array, spread: float) -> float:
    """How far a joint may be beside the hull of `points` [rad or m].

    Joints whose lags differ are at different times of one course. A joint that is `spread` cycles before or behind the
    others is away from their place by no more than the fastest step of those cycles. The tolerance is added.

    Args:
        points: (k, n) setpoints, in the order of their course [rad or m].
        joint: index of the joint.
        tolerance: (n,) [rad or m].
        spread: half of the greatest difference between the lags of two joints [cycles].
    """
    fastest = 0.0
    for k in range(1, len(points)):
        fastest = max(fastest, abs(points[k, joint] - points[k - 1, joint]))
    return float(tolerance[joint] + spread * fastest)


@compiled
def widths(points: Array, tolerance: Array, spread: float) -> Array:
    """(n,) how far each joint may be beside the hull of `points`, as `beside` has it."""
    found = np.empty(points.shape[1])
    for joint in range(points.shape[1]):
        found[joint] = beside(points, joint, tolerance, spread)
    return found


@compiled
def off_hull(points: Array, q: Array, width: Array) -> Array:
    """(n,) how far a robot is beside the hull of its setpoints, signed [rad or m].

    The nearest point of the hull is sought in units of `width`, by steps that move weight from the farthest vertex to
    the nearest (pairwise Frank-Wolfe, Lacoste-Julien and Jaggi 2015). The search ends at the first point that is within
    the width in every joint, or when a plane shows that there is none. If it ends before, the answer may be too large.

    Args:
        points: (k, n) setpoints, the newest last [rad or m].
        q: (n,) measured.
        width: (n,) positive.
    """
    # by numbers: for whole rows numba compiles what says that their shapes differ, for three seconds
    count, joints = points.shape
    vertices, rest = np.empty((count, joints)), np.empty(joints)
    weight, along = np.zeros(count), np.empty(count)
    nearest = 0
    for k in range(count):
        for joint in range(joints):
            vertices[k, joint] = (points[k, joint] - q[joint]) / width[joint]
        if _product(vertices, k, vertices[k]) < _product(vertices, nearest, vertices[nearest]):
            nearest = k
    weight[nearest] = 1.0
    for joint in range(joints):
        rest[joint] = vertices[nearest, joint]
    for _ in range(_SEARCH_STEPS):
        most = total = square = 0.0
        for joint in range(joints):
            most, total = max(most, abs(rest[joint])), total + abs(rest[joint])
            square += rest[joint] * rest[joint]
        if most <= 1.0:
            break
        towards = away = -1
        for k in range(count):
            along[k] = _product(vertices, k, rest)
            if towards < 0 or along[k] < along[towards]:
                towards = k
            if weight[k] > 0.0 and (away < 0 or along[k] > along[away]):
                away = k
        if square - along[towards] <= _NEAREST or along[towards] > total:
            break
        step = _square(vertices, away, towards)
        share = min(max((along[away] - along[towards]) / step, 0.0), weight[away])
        weight[away] -= share
        weight[towards] += share
        for joint in range(joints):
            rest[joint] += share * (vertices[towards, joint] - vertices[away, joint])
    for joint in range(joints):
        rest[joint] *= -width[joint]
    return rest


@inlined
def _product(vertices: Array, k: int, vector: Array) -> float:
    product = 0.0
    for joint in range(len(vector)):
        product += vertices[k, joint] * vector[joint]
    return product


@makes_no_array
def write_box(points: Array, middle: Array, half: Array) -> None:
    """Write middle and half-widths, each at least (n,), of the box around `points` (k, n) [rad or m]."""
    for joint in range(points.shape[1]):
        low = high = points[0, joint]
        for k in range(1, len(points)):
            low, high = min(low, points[k, joint]), max(high, points[k, joint])
        middle[joint], half[joint] = (low + high) / 2.0, (high - low) / 2.0


@makes_no_array
def write_span(
    points: Array,
    middle: Array,
    offset: Array,
    deviation: Array,
    kept: Integers,
    beside: Array,
    aside: Array,
) -> int:
    """Write a span that holds the hull of `points` (k, n) [rad or m]; returns how many vertices it has.

    Its vertices are the first and the last point and, one after the other, that which lies farthest beside the line
    from vertex to vertex (Ramer 1972, Douglas and Peucker 1973), as long as there is one. All other points are as far
    from that line as the span is wide.

    Args:
        points: to be held, in the order of their course.
        middle: (n,) or longer, from which offsets are counted.
        offset: (VERTICES, at least n), is written to.
        deviation: at least (n,), is written to.
        kept: (2, VERTICES), is written to.
        beside: (VERTICES,), is written to.
        aside: at least (2, n), is written to.
    """
    joints, last = points.shape[1], len(points) - 1
    vertices = 2
    kept[0, 0], kept[0, 1] = 0, last
    _look_beside(points, 0, kept, beside)
    while vertices < VERTICES:
        widest = 0
        for line in range(1, vertices - 1):
            if beside[line] > beside[widest]:
                widest = line
        if beside[widest] <= SHORTEST:
            break
        for line in range(vertices, widest + 1, -1):
            kept[0, line] = kept[0, line - 1]
            kept[1, line - 1], beside[line - 1] = kept[1, line - 2], beside[line - 2]
        kept[0, widest + 1] = kept[1, widest]
        vertices += 1
        _look_beside(points, widest, kept, beside)
        _look_beside(points, widest + 1, kept, beside)
    for joint in range(joints):
        aside[0, joint] = aside[1, joint] = 0.0
    for line in range(vertices - 1):
        start, end = kept[0, line], kept[0, line + 1]
        square = _square(points, start, end)
        for k in range(start + 1, end):
            t = _foot(points, start, end, k, square)
            for joint in range(joints):
                off = _off(points, start, end, k, t, joint)
                aside[0, joint] = min(aside[0, joint], off)
                aside[1, joint] = max(aside[1, joint], off)
    if vertices == 2 and _square(points, 0, last) == 0.0:
        vertices = 1
    for joint in range(joints):
        deviation[joint] = (aside[1, joint] - aside[0, joint]) / 2.0
        shift = (aside[0, joint] + aside[1, joint]) / 2.0 - middle[joint]
        for vertex in range(vertices):
            offset[vertex, joint] = points[kept[0, vertex], joint] + shift
    return vertices


@inlined
def centre(middle: Array, half: Array, offset: Array, vertices: int, deviation: Array, joints: int) -> None:
    """Move the middle of a span to that of the box around its vertices, and write that box with its deviation."""
    for joint in range(joints):
        low, high = math.inf, -math.inf
        for vertex in range(vertices):
            low, high = min(low, offset[vertex, joint]), max(high, offset[vertex, joint])
        shift = (low + high) / 2.0
        middle[joint] += shift
        half[joint] = (high - low) / 2.0 + deviation[joint]
        for vertex in range(vertices):
            offset[vertex, joint] -= shift


@inlined
def _look_beside(points: Array, line: int, kept: Integers, beside: Array) -> None:
    """Find the point that lies farthest beside a line between two vertices."""
    start, end = kept[0, line], kept[0, line + 1]
    square = _square(points, start, end)
    farthest, most = start, 0.0
    for k in range(start + 1, end):
        t = _foot(points, start, end, k, square)
        for joint in range(points.shape[1]):
            off = abs(_off(points, start, end, k, t, joint))
            if off > most:
                farthest, most = k, off
    kept[1, line], beside[line] = farthest, most


@inlined
def _square(points: Array, start: int, end: int) -> float:
    square = 0.0
    for joint in range(points.shape[1]):
        square += (points[end, joint] - points[start, joint]) ** 2
    return square


@inlined
def _foot(points: Array, start: int, end: int, k: int, square: float) -> float:
    """Where between 0 and 1 a line from point to point comes nearest to another."""
    if square == 0.0:
        return 0.0
    t = 0.0
    for joint in range(points.shape[1]):
        t += (points[k, joint] - points[start, joint]) * (points[end, joint] - points[start, joint])
    return min(max(t / square, 0.0), 1.0)


@inlined
def _off(points: Array, start: int, end: int, k: int, t: float, joint: int) -> float:
    return float(points[k, joint] - points[start, joint] - t * (points[end, joint] - points[start, joint]))
