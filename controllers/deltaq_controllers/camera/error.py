"""The view direction error of a camera: stereographic projection and its closed-form derivatives.

Bjerkeng et al., III-A. The camera frame is the paper's: its third axis e3 is the view axis, its first axis
e1 points up in the picture. The paper cites the derivatives only; with `u = (p - x) / d`, `d = |p - x|`,
`y = R^T u` (a unit vector in R^3) and `S = [I2, -Psi] / (1 + y3)` they are

    P   = S R^T (I - u u^T) / d                 (2, 3)
    J_t = -P (J_v - [p - x]x J_w) = -P J_p      (2, n)

where `J_p` is the linear Jacobian of the point of the camera's rigid body that lies at p. At exactly 180 degrees
(3) is 0/0 and every direction of rotation is equally short; from within `ANTIPODE_RAD` of it, `look` takes the
error to be `ANTIPODE_RAD` short of it, in the direction of rotation `way_round`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.vectors import components, cross, distance
from deltaq_protocol.arrays import Array

ANTIPODE_RAD = 1e-3
"""Errors within this of 180 degrees are taken as exactly this far from it [rad]."""

MIN_DISTANCE_M = 1e-3
"""A focus nearer to the lens than this has no direction: it is taken as this far away, straight ahead [m]."""


class Look(NamedTuple):
    """Direction and distance of the focus as the camera sees it.

    Attributes:
        psi: (2,) stereographic error (3); its norm is tan(angle / 2).
        angle: view angle error in [0, pi) [rad].
        direction: (2,) unit vector of psi; (0, 1) where psi is zero.
        distance: view distance [m].
        u: (3,) unit vector from the lens to the focus, in the world.
        P: (2, 3) derivative of psi with respect to the focus [1/m].
        stretch: (1 + |psi|^2) / 2, both singular values of d psi / d angle.
        undecided: every direction of rotation is equally short, and `way_round` was used.
    """

    psi: Array
    angle: float
    direction: Array
    distance: float
    u: Array
    P: Array
    stretch: float
    undecided: bool


class CameraPose(NamedTuple):
    """Pose and velocities of the camera: `Kinematics.rotation`, `position` and `twists`."""

    rotation: Array
    position: Array
    twists: Array


@compiled
def look(rotation: Array, position: Array, focus: Array, way_round: Array | None = None) -> Look:
    """The error (3) and its derivative P.

    Args:
        rotation: (3, 3) camera axes in the world, `[e1, e2, e3]`.
        position: (3,) lens in the world [m].
        focus: (3,) point to look at, in the world [m].
        way_round: (2,) unit vector in the picture, the way round to take from 180 degrees, or its
            opposite, whichever the focus is nearer to; sideways if not given.
    """
    away = distance(position, focus)
    if away > MIN_DISTANCE_M:
        u = (focus - position) / away
    else:
        u, away = rotation[:, 2].copy(), MIN_DISTANCE_M
    y = components(rotation, u)
    sine = math.hypot(y[0], y[1])
    angle = math.atan2(sine, y[2])
    e = y[:2] / sine if sine > 1e-12 else np.array([0.0, 1.0])
    undecided = math.pi - angle < ANTIPODE_RAD
    if undecided:
        angle = math.pi - ANTIPODE_RAD
        way = np.array([0.0, 1.0]) if way_round is None else way_round
        e = math.copysign(1.0, y[0] * way[0] + y[1] * way[1]) * way
        across = e[0] * rotation[:, 0] + e[1] * rotation[:, 1]
        u = math.sin(angle) * across + math.cos(angle) * rotation[:, 2]
    # 1 + y3 loses all its digits near the antipode; tan(angle / 2) does not
    size = math.tan(0.5 * angle)
    psi = size * e
    stretch = 0.5 * (1.0 + size * size)
    # S R^T (I - u u^T) = stretch (B - psi u^T) with B = [I2, -psi] R^T, since B u = psi
    P = np.empty((2, 3))
    for row in range(2):
        P[row] = (stretch / away) * (rotation[:, row] - psi[row] * (rotation[:, 2] + u))
    return Look(psi, angle, e, away, u, P, stretch, undecided)


@compiled
def easiest_way_round(rotation: Array, focus: Array, twists: Array) -> Array:
    """The direction in the picture in which the joints move the focus most easily.

    From 180 degrees every direction of rotation is equally short, but not every one need be possible: a focus
    behind the camera on the axis of A1, with A4 and A5 at zero, can only be reached over the top.

    Args:
        rotation: (3, 3) camera axes in the world.
        focus: (3,) point that the camera's body moves there [m].
        twists: (6, n) velocities of the camera's body at the world's origin, linear over angular.

    Returns:
        (2,) unit vector.
    """
    a = b = c = 0.0
    for joint in range(twists.shape[1]):
        moved = components(rotation, twists[:3, joint] + cross(twists[3:, joint], focus))
        a += moved[0] * moved[0]
        b += moved[0] * moved[1]
        c += moved[1] * moved[1]
    # the major axis of [[a, b], [b, c]]
    turned = 0.5 * math.atan2(2.0 * b, a - c)
    return np.array([math.cos(turned), math.sin(turned)])


@compiled
def look_on(rotation: Array, position: Array, focus: Array, twists: Array) -> Look:
    """`look`, from 180 degrees by the easiest way round; all arguments as there and in `easiest_way_round`."""
    view = look(rotation, position, focus)
    if view.undecided:
        return look(rotation, position, focus, easiest_way_round(rotation, focus, twists))
    return view


@compiled
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
    forces = np.empty((3, 3))
    forces[:2], forces[2] = -view.P, view.u
    rows = np.zeros((3, twists.shape[1]))
    for row in range(3):
        # (4) moves the body's point at the focus, the approach its lens
        wrench = np.concatenate((forces[row], cross(focus if row < 2 else position, forces[row])))
        for joint in range(twists.shape[1]):
            for axis in range(6):
                rows[row, joint] += wrench[axis] * twists[axis, joint]
    return rows[:2], rows[2]


def view_angle(rotation: Array, position: Array, focus: Array) -> float:
    """Angle between view axis and focus [rad], as plotted in Figs. 8 and 9, with `p - x` (errata)."""
    y1, y2, y3 = (rotation.T @ (focus - position)).tolist()
    return math.atan2(math.hypot(y1, y2), y3)
