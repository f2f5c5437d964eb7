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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ANTIPODE_RAD = 1e-3
"""Errors within this of 180 degrees are taken as exactly this far from it [rad]."""

MIN_DISTANCE_M = 1e-3
"""A focus nearer to the lens than this has no direction: it is taken as this far away, straight ahead [m]."""


class Look(NamedTuple):
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
    # three numbers at a time, plain floats are several times quicker than arrays
    (a1, a2, a3), (b1, b2, b3), (c1, c2, c3) = rotation.tolist()
    x1, x2, x3 = position.tolist()
    p1, p2, p3 = focus.tolist()
    u1, u2, u3 = p1 - x1, p2 - x2, p3 - x3
    distance = math.sqrt(u1 * u1 + u2 * u2 + u3 * u3)
    if distance > MIN_DISTANCE_M:
        u1, u2, u3 = u1 / distance, u2 / distance, u3 / distance
    else:
        u1, u2, u3, distance = a3, b3, c3, MIN_DISTANCE_M
    y1 = a1 * u1 + b1 * u2 + c1 * u3
    y2 = a2 * u1 + b2 * u2 + c2 * u3
    y3 = a3 * u1 + b3 * u2 + c3 * u3
    sine = math.hypot(y1, y2)
    angle = math.atan2(sine, y3)
    undecided = math.pi - angle < ANTIPODE_RAD
    if undecided:
        angle = math.pi - ANTIPODE_RAD
        way1, way2 = (0.0, 1.0) if way_round is None else way_round.tolist()
        sine = math.copysign(math.sin(angle), y1 * way1 + y2 * way2)
        y1, y2, y3 = sine * way1, sine * way2, math.cos(angle)
        u1, u2, u3 = (rotation @ np.array([y1, y2, y3])).tolist()
        sine = abs(sine)
    # 1 + y3 loses all its digits near the antipode; tan(angle / 2) does not
    size = math.tan(0.5 * angle)
    e1, e2 = (y1 / sine, y2 / sine) if sine > 1e-12 else (0.0, 1.0)
    psi1, psi2 = size * e1, size * e2
    stretch = 0.5 * (1.0 + size * size)
    # S R^T (I - u u^T) = stretch (B - psi u^T) with B = [I2, -psi] R^T, since B u = psi
    scale = stretch / distance
    v1, v2, v3 = a3 + u1, b3 + u2, c3 + u3
    P = np.array(
        [
            [scale * (a1 - psi1 * v1), scale * (b1 - psi1 * v2), scale * (c1 - psi1 * v3)],
            [scale * (a2 - psi2 * v1), scale * (b2 - psi2 * v2), scale * (c2 - psi2 * v3)],
        ]
    )
    u, psi, direction = np.array([u1, u2, u3]), np.array([psi1, psi2]), np.array([e1, e2])
    return Look(psi, angle, direction, distance, u, P, stretch, undecided)


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


def view_jacobians(view: Look, position: Array, focus: Array, twists: Array) -> tuple[Array, Array]:
    """The task Jacobian of (4), and how the lens approaches the focus.

    A wrench acts on the twists of all joints at once: a force f at a point o is `[f, o x f]` at the world's origin.

    Args:
        view: from `look`.
        position: (3,) lens in the world [m].
        focus: (3,) point to look at [m].
        twists: (6, n) velocities of the camera's body at the world's origin, linear over angular.

    Returns:
        (2, n) derivative of psi with respect to q, and (n,) speed of the lens towards the focus per joint rate [m].
    """
    (a1, a2, a3), (b1, b2, b3) = view.P.tolist()
    p1, p2, p3 = focus.tolist()
    u1, u2, u3 = view.u.tolist()
    x1, x2, x3 = position.tolist()
    wrenches = np.array(
        [
            [-a1, -a2, -a3, p3 * a2 - p2 * a3, p1 * a3 - p3 * a1, p2 * a1 - p1 * a2],
            [-b1, -b2, -b3, p3 * b2 - p2 * b3, p1 * b3 - p3 * b1, p2 * b1 - p1 * b2],
            [u1, u2, u3, x2 * u3 - x3 * u2, x3 * u1 - x1 * u3, x1 * u2 - x2 * u1],
        ]
    )
    rows: Array = wrenches @ twists
    return rows[:2], rows[2]


def view_angle(rotation: Array, position: Array, focus: Array) -> float:
    """Angle between view axis and focus [rad]; what Figs. 8 and 9 plot, with `p - x` (errata)."""
    y1, y2, y3 = (rotation.T @ (focus - position)).tolist()
    return math.atan2(math.hypot(y1, y2), y3)
