"""The view direction error of a camera: stereographic projection and its closed-form derivatives.

Bjerkeng et al., III-A. The camera frame is the paper's: its third axis e3 is the view axis, its first axis
e1 points up in the picture. The paper cites the derivatives only; with `u = (p - x) / d`, `d = |p - x|`,
`y = R^T u` (a unit vector in R^3) and `S = [I2, -Psi] / (1 + y3)` they are

    P   = S R^T (I - u u^T) / d                 (2, 3)
    J_t = -P (J_v - [p - x]x J_w) = -P J_p      (2, n)

where `J_p` is the linear Jacobian of the point of the camera's rigid body that lies at p. At exactly 180
degrees (3) is 0/0 and every way round is as short; from within `ANTIPODE_RAD` of it, `look` takes the error to be
`ANTIPODE_RAD` short of it, on the way round that it is told to take.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ANTIPODE_RAD = 1e-3
"""Errors within this of 180 degrees are taken as exactly this far from it [rad]."""

MIN_DISTANCE_M = 1e-3
"""A focus nearer to the lens than this has no direction: it is taken as this far away, straight ahead [m]."""


@dataclass(frozen=True)
class Look:
    """Where the focus lies as the camera sees it.

    Attributes:
        psi: (2,) stereographic error (3); its norm is tan(angle / 2).
        angle: view angle error in [0, pi) [rad].
        direction: (2,) unit vector of psi; (0, 1) where psi is zero.
        distance: view distance [m].
        u: (3,) unit vector from the lens to the focus, in the world.
        P: (2, 3) derivative of psi with respect to the focus [1/m].
        stretch: (1 + |psi|^2) / 2, both singular values of d psi / d angle.
        undecided: every way round is as short, and `way_round` was taken.
    """

    psi: Array
    angle: float
    direction: Array
    distance: float
    u: Array
    P: Array
    stretch: float
    undecided: bool


def look(rotation: Array, position: Array, focus: Array, way_round: Array | None = None) -> Look:
    """The error (3) and its derivative P.

    Args:
        rotation: (3, 3) camera axes in the world, `[e1, e2, e3]`.
        position: (3,) lens in the world [m].
        focus: (3,) point to look at, in the world [m].
        way_round: (2,) unit vector in the picture, the way round to take from 180 degrees, or its
            opposite, whichever the focus is nearer to; to the side if not given.
    """
    to_focus = focus - position
    distance = math.sqrt(to_focus @ to_focus)
    u = to_focus / distance if distance > MIN_DISTANCE_M else rotation[:, 2]
    y1, y2, y3 = (rotation.T @ u).tolist()
    sine = math.hypot(y1, y2)
    angle = math.atan2(sine, y3)
    undecided = math.pi - angle < ANTIPODE_RAD
    if undecided:
        angle = math.pi - ANTIPODE_RAD
        way1, way2 = (0.0, 1.0) if way_round is None else way_round.tolist()
        sine = math.copysign(math.sin(angle), y1 * way1 + y2 * way2)
        y1, y2, y3 = sine * way1, sine * way2, math.cos(angle)
        u, sine = rotation @ np.array([y1, y2, y3]), abs(sine)
    # 1 + y3 loses all its digits near the antipode; tan(angle / 2) does not
    size = math.tan(0.5 * angle)
    direction = np.array([y1, y2]) / sine if sine > 1e-12 else np.array([0.0, 1.0])
    psi = size * direction
    stretch = 0.5 * (1.0 + size * size)
    # S R^T (I - u u^T) = stretch (B - psi u^T) with B = [I2, -psi] R^T, since B u = psi
    across = rotation[:, :2].T - np.outer(psi, rotation[:, 2] + u)
    distance = max(distance, MIN_DISTANCE_M)
    return Look(psi, angle, direction, distance, u, (stretch / distance) * across, stretch, undecided)


def easiest_way_round(rotation: Array, jacobian_at_focus: Array) -> Array:
    """The direction in the picture in which the joints move the focus most easily.

    From 180 degrees every way round is as short, but not every one need be open: a focus behind the camera on
    the axis of A1, with A4 and A5 at zero, can only be reached over the top.

    Args:
        rotation: (3, 3) camera axes in the world.
        jacobian_at_focus: (3, n) linear Jacobian of the camera's body at the focus.

    Returns:
        (2,) unit vector.
    """
    in_picture = rotation[:, :2].T @ jacobian_at_focus
    way: Array = np.linalg.eigh(in_picture @ in_picture.T)[1][:, 1]
    return way


def skew(v: Array) -> Array:
    """(3, 3) matrix of the cross product: `skew(v) @ w = v x w`."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def task_jacobian(P: Array, position: Array, focus: Array, jacobian: Array) -> Array:
    """The task Jacobian of (4).

    Args:
        P: (2, 3) from `look`.
        position: (3,) point that `jacobian` belongs to [m].
        focus: (3,) point to look at [m].
        jacobian: (6, n) linear over angular Jacobian of that point, world axes.

    Returns:
        (2, n) derivative of psi with respect to q.
    """
    at_focus: Array = jacobian[:3] - skew(focus - position) @ jacobian[3:]
    return -P @ at_focus


def view_angle(rotation: Array, position: Array, focus: Array) -> float:
    """Angle between view axis and focus [rad]; what Figs. 8 and 9 plot, with `p - x` (errata)."""
    y1, y2, y3 = (rotation.T @ (focus - position)).tolist()
    return math.atan2(math.hypot(y1, y2), y3)
