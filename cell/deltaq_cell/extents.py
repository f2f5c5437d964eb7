"""The extents of bodies: corners, widened by a ball and by a disc.

A hull is its corners, a sphere a corner and a ball, a capsule two corners and a ball, a cylinder two corners and a
disc across its axis. This gives exactly how far a body reaches in a direction, and how far its points
are from an axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np

from deltaq_protocol.arrays import Array


class Extents:
    """The extents of some bodies, each in the frame of the joint that moves it.

    Attributes:
        corners: (bodies, k, 3), bodies with fewer than k corners repeat their first [m].
        axis: (bodies, 3) unit vector across which the disc lies.
        disc: (bodies,) its radius, zero for bodies without [m].
        ball: (bodies,) radius of the ball, zero for bodies without [m].
    """

    def __init__(self, bodies: Sequence[Any]) -> None:
        corners, disc, ball = zip(*[_extent(body.geometry) for body in bodies], strict=True)
        self.disc: Array = np.array(disc)
        self.ball: Array = np.array(ball)
        most = max(len(points) for points in corners)
        padded = [np.vstack([points, np.tile(points[:1], (most - len(points), 1))]) for points in corners]
        rotation = np.array([body.placement.rotation for body in bodies])
        translation = np.array([body.placement.translation for body in bodies])
        self.corners: Array = np.array(padded) @ rotation.transpose(0, 2, 1) + translation[:, None]
        self.axis: Array = rotation[:, :, 2]


def _extent(shape: Any) -> tuple[Array, float, float]:
    """Corners (k, 3), radius of the disc and radius of the ball of one shape in its own frame."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), 0.0, shape.radius
    if isinstance(shape, coal.Capsule | coal.Cylinder):
        ends = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
        round_ended = isinstance(shape, coal.Capsule)
        return ends, 0.0 if round_ended else shape.radius, shape.radius if round_ended else 0.0
    if isinstance(shape, coal.Convex):
        return np.array([shape.point(index) for index in range(shape.num_points)]), 0.0, 0.0
    return _box_around(shape), 0.0, 0.0


def corners_of(body: Any) -> Array:
    """(8, 3) corners, in the joint's frame, of the box around a body."""
    corners: Array = _box_around(body.geometry) @ body.placement.rotation.T + body.placement.translation
    return corners


def _box_around(shape: Any) -> Array:
    """(8, 3) corners of the box around any shape, in its own frame."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=bool)
    return np.where(bits, high, low)
