"""Bodies taken for capsules, and distances of many of them at once."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from deltaq_controllers.spheres import local_box
from deltaq_protocol.arrays import Array

_TINY = 1e-12

_STEPS = np.linspace(0.0, 1.0, 9)


def capsule(body: Any) -> tuple[Array, Array, float]:
    """A body as a capsule, in the frame of the joint that carries it.

    The rims of a cylinder stick out of its capsule by a sixth of the radius, and its ends reach a third of it too
    far. That of a box or hull is as wide as its sides are on average.

    Args:
        body: a pinocchio geometry object.

    Returns:
        Middle (3,), half of the axis as a vector (3,), and radius [m].
    """
    low, high = local_box(body)
    size = high - low
    along = int(np.argmax(size))
    shape = body.geometry
    if isinstance(shape, coal.Sphere):
        radius, half = float(shape.radius), 0.0
    elif isinstance(shape, coal.Capsule):
        along, radius, half = 2, float(shape.radius), float(shape.halfLength)
    elif isinstance(shape, coal.Cylinder):
        along, radius, half = 2, float(shape.radius), float(shape.halfLength)
        # a disc becomes a ball between its height and its width, a longer one keeps its width
        radius, half = (0.5 * (radius + half), 0.0) if half < radius else (1.05 * radius, half - 0.7 * radius)
    else:
        width = np.delete(size, along)
        radius = 0.5 * float(np.sqrt(width[0] * width[1]))
        half = max(0.0, 0.5 * float(size[along]) - 0.5 * radius)
    axis = np.zeros(3)
    axis[along] = half
    middle: Array = np.array(body.placement.act(0.5 * (low + high)))
    return middle, body.placement.rotation @ axis, radius


def segment_points(c1: Array, h1: Array, c2: Array, h2: Array) -> tuple[Array, Array]:
    """Nearest points of pairs of segments.

    Args:
        c1: (M, 3) middles of the first.
        h1: (M, 3) halves of the first, as vectors.
        c2: (M, 3) middles of the second.
        h2: (M, 3) halves of the second.

    Returns:
        (M, 3) nearest point on each.
    """
    between = c1 - c2
    a, e = (h1 * h1).sum(axis=1), (h2 * h2).sum(axis=1)
    b, c, f = (h1 * h2).sum(axis=1), (h1 * between).sum(axis=1), (h2 * between).sum(axis=1)
    determinant = a * e - b * b
    # parallel ones are near each other wherever, and where the second is a point the first is nearest at its foot
    foot = -c / np.maximum(a, _TINY)
    s = np.where(determinant > _TINY, (b * f - c * e) / np.maximum(determinant, _TINY), foot)
    s = np.clip(s, -1.0, 1.0)
    free = (b * s + f) / np.maximum(e, _TINY)
    t = np.clip(free, -1.0, 1.0)
    s = np.where(t == free, s, np.clip((b * t - c) / np.maximum(a, _TINY), -1.0, 1.0))
    return c1 + s[:, None] * h1, c2 + t[:, None] * h2


def box_distance(points: Array, half: Array) -> Array:
    """(...) distance of points (..., 3) from a box (..., 3) around the origin; negative inside."""
    beyond = np.abs(points) - half
    outside = np.maximum(beyond, 0.0)
    distance: Array = np.sqrt((outside * outside).sum(axis=-1)) + np.minimum(beyond.max(axis=-1), 0.0)
    return distance


def box_points(c: Array, h: Array, half: Array) -> tuple[Array, Array, Array]:
    """Nearest points of segments and boxes, in the boxes' frames.

    The distance is convex along a segment, so that it is searched in two passes of nine points.

    Args:
        c: (M, 3) middles of the segments.
        h: (M, 3) halves of the segments, as vectors.
        half: (M, 3) halves of the boxes' sizes.

    Returns:
        (M, 3) nearest point on the segment, (M, 3) nearest on the box's faces, (M,) distance, negative inside.
    """
    rows = np.arange(len(c))
    low, high = np.full(len(c), -1.0), np.ones(len(c))
    for _ in range(2):
        shares = low[:, None] + (high - low)[:, None] * _STEPS
        points = c[:, None] + shares[:, :, None] * h[:, None]
        distances = box_distance(points, half[:, None])
        best = distances.argmin(axis=1)
        step = (high - low) / (len(_STEPS) - 1)
        share = shares[rows, best]
        low, high = np.maximum(-1.0, share - step), np.minimum(1.0, share + step)
    point, distance = points[rows, best], distances[rows, best]
    on_box = np.clip(point, -half, half)
    inside = distance < 0.0
    if inside.any():
        face = (np.abs(point) - half).argmax(axis=1)[inside]
        which = np.flatnonzero(inside)
        on_box[which, face] = np.where(point[which, face] < 0.0, -1.0, 1.0) * half[which, face]
    return point, on_box, distance
