"""Limit the speed of a motion so that hands stay, or stay together, even if the gate brakes it at any time."""

from __future__ import annotations

import math

import numpy as np

from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_protocol.arrays import Array

BRAKED_M, BRAKED_RAD = 2.5e-5, 5e-5
"""How far a hand may be off at the end of a brake, which is straight in joint space [m, rad]."""

PARTED_M, PARTED_RAD = 5e-4, 1e-3
"""How far hands that hold an object may be off from one another at the end of such a brake [m, rad]."""

GLIMPSE_S = 1e-3
"""Time over which the rates of a motion are compared [s]."""


def kept_while_braked(hands: Hands, q: Array, rates: Array, max_acceleration: Array) -> float:
    """The share of its rates from which a self-motion can be braked without moving the hands."""
    return min(1.0, allowed_while_braked(hands, q, rates, max_acceleration))


def allowed_while_braked(hands: Hands, q: Array, rates: Array, max_acceleration: Array) -> float:
    """By how much the rates of a self-motion may be multiplied for a brake to leave the hands where they are.

    The error of the hands after a straight brake grows with the square of the brake's length, and that length with the
    square of the speed.

    Args:
        hands: of the robot.
        q: (n,) configuration [rad or m].
        rates: (n,) of a motion that keeps the hands [rad/s or m/s].
        max_acceleration: (n,) of the robot [rad/s^2 or m/s^2].
    """
    brake_s = float(np.max(np.abs(rates) / max_acceleration))
    hands.place(q)
    rotations, positions = hands.rotations, hands.positions
    hands.place(q + 0.5 * brake_s * rates)
    off = np.linalg.norm(hands.error(rotations, positions).reshape(-1, 2, 3), axis=2).max(axis=0)
    excess = float(np.max(off / (BRAKED_M, BRAKED_RAD)))
    return float(excess**-0.25) if excess > 0.0 else math.inf


def kept_together_while_braked(
    hands: Hands, held: HeldObject, q: Array, rates: Array, max_acceleration: Array
) -> float:
    """By how much the rates of an object that hands hold may be multiplied for a brake to keep them together.

    Args:
        hands: of the robot.
        held: the object between them.
        q: (n,) configuration [rad or m].
        rates: (n,) of a motion that keeps them together [rad/s or m/s].
        max_acceleration: (n,) of the robot [rad/s^2 or m/s^2].
    """
    brake_s = float(np.max(np.abs(rates) / max_acceleration))
    hands.place(q + 0.5 * brake_s * rates)
    excess = float(np.max(np.array(held.parted(hands.rotations, hands.positions)) / (PARTED_M, PARTED_RAD)))
    return float(excess**-0.25) if excess > 0.0 else math.inf
