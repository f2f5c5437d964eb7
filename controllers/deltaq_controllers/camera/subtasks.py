"""Sub-tasks in the null space of the camera task: view distance and camera roll.

Bjerkeng et al., III-D. (14) is right as printed, with x for q in the view distance. (15) is right for an A6 that
turns about -e3, as KUKA's does; here the joint's own effect on the roll decides the sign (errata).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array

LEVEL_RATIO = 0.1
"""Sine of the angle between view axis and vertical below which roll is not corrected."""


class RollJoint(NamedTuple):
    """The joint that levels the picture: its number and limits [rad], and whether it moves nothing but the roll."""

    number: int
    lower: float
    upper: float
    is_free: bool


@compiled
def view_distance_field(gain: float, approach: Array, error: float) -> Array:
    """F_d of (14): towards the focus while the camera is too far from it.

    Args:
        gain: k [1/(m s)].
        approach: (n,) `J_v^T u`, speed of the lens towards the focus per joint rate [m/rad].
        error: view distance less the desired one [m].

    Returns:
        (n,) field [rad/s or m/s].
    """
    return (gain * error) * approach


@compiled
def roll(rotation: Array) -> float:
    """Camera roll [rad]: `atan2(R32, R31)`, zero when e1 points as far up as the view axis lets it."""
    return math.atan2(rotation[2, 1], rotation[2, 0])


@compiled
def roll_effect(rotation: Array, axis: Array) -> float:
    """How fast a joint turns the roll angle: d roll / d q of (15).

    Args:
        rotation: (3, 3) camera axes in the world.
        axis: (3,) axis of the joint in the world.

    Returns:
        The derivative; zero for a camera that looks straight up or down, where there is no roll.
    """
    # turning about w moves e_i . z by w . (e_i x z), and roll = atan2(e2 . z, e1 . z)
    e1, e2 = rotation[:, 0], rotation[:, 1]
    level = e1[2] * e1[2] + e2[2] * e2[2]
    if level < LEVEL_RATIO**2:
        return 0.0
    across1, across2 = axis[0] * e1[1] - axis[1] * e1[0], axis[0] * e2[1] - axis[1] * e2[0]
    return float((e1[2] * across2 - e2[2] * across1) / level)


@compiled
def roll_effects(rotation: Array, axes: Array) -> Array:
    """`roll_effect` of every joint: (n,) derivatives from (3, 3) camera axes and (3, n) joint axes."""
    effects = np.empty(axes.shape[1])
    for joint in range(axes.shape[1]):
        effects[joint] = roll_effect(rotation, axes[:, joint])
    return effects


@compiled
def turn_to_level(rotation: Array, axis: Array, q: float, lower: float, upper: float) -> float:
    """How far the roll joint has to turn for a level picture, in the direction that its limits leave open.

    Args:
        rotation: (3, 3) camera axes in the world.
        axis: (3,) axis of the roll joint in the world.
        q: its angle [rad].
        lower: its lower limit [rad].
        upper: its upper limit [rad].

    Returns:
        Angle to turn [rad]: the nearest level position inside the limits, or the nearest one if none is;
        zero where the joint does not turn the picture.
    """
    effect = roll_effect(rotation, axis)
    if abs(effect) < LEVEL_RATIO:
        return 0.0
    shortest = -roll(rotation) / effect
    around = math.copysign(2.0 * math.pi / abs(effect), shortest)
    # the next longer turns go in the opposite direction, and once more around
    for way in (shortest, shortest - around, shortest + around):
        if lower < q + way < upper:
            return way
    return shortest


def turns_about_view_axis(rotation: Array, position: Array, axis: Array, moment: Array) -> bool:
    """Whether a joint's axis is the view axis, so that it turns the picture and nothing else.

    Args:
        rotation: (3, 3) camera axes in the world.
        position: (3,) lens in the world [m].
        axis: (3,) axis of the joint in the world.
        moment: (3,) velocity at the world's origin per joint rate [m/rad].
    """
    lens_velocity = moment + np.cross(axis, position)
    across = np.cross(axis, rotation[:, 2])
    return bool(np.linalg.norm(lens_velocity) < 1e-9 and np.linalg.norm(across) < 1e-9)
