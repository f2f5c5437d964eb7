"""Boxes around bodies, turned so that they are tight."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.arrays import Array


def oriented_box(corners: Array, axis: Array, disc: float, ball: float) -> tuple[Array, Array, Array]:
    """The smallest of some boxes around a body: along its own frame, along its corners, or along its axis.

    Args:
        corners: (k, 3) of the body [m].
        axis: (3,) unit vector across which the disc lies.
        disc: radius, zero without [m].
        ball: radius, zero without [m].

    Returns:
        Rows of unit vectors along its edges (3, 3), its centre (3,) and half edges (3,) [m].
    """
    principal = np.linalg.svd(corners - corners.mean(axis=0))[2]
    about_axis = np.linalg.svd(axis[None])[2]
    boxes = [_along(axes, corners, axis, disc, ball) for axes in (np.eye(3), principal, about_axis)]
    return min(boxes, key=lambda box: float(np.prod(box[2])))


def _along(axes: Array, corners: Array, axis: Array, disc: float, ball: float) -> tuple[Array, Array, Array]:
    reach = corners @ axes.T
    # a disc reaches along a unit vector as far as that is across its axis
    wider = disc * np.linalg.norm(_cross(axes, axis), axis=1) + ball
    low, high = reach.min(axis=0) - wider, reach.max(axis=0) + wider
    return axes, axes.T @ ((low + high) / 2), (high - low) / 2


def _cross(rows: Array, vector: Array) -> Array:
    """What `np.cross` gives, without its detours through axes in any order: there are some hundred bodies."""
    (x, y, z), (a, b, c) = rows.T, vector
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
