"""A step of the arm along a course, compiled; more than a thousand are simulated in a cycle.

The joints that a course leads go to its goal, as fast as speed and acceleration let them; those that the view needs
are turned by the law (9). View and law are those of `deltaq_controllers.camera.error` and `.redundancy`, and a test
holds them against these; they are written out here because these make arrays, which took most of a step's time.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Placed
from deltaq_controllers.camera.error import ANTIPODE_RAD, MIN_DISTANCE_M
from deltaq_controllers.camera.escape.arm import EscapingArm
from deltaq_protocol.arrays import Array

_TURNS = 0.5
"""Fraction of the view's error that one step removes."""

_BRAKES = 0.8
"""Fraction of its deceleration that a joint uses before its limit; before a goal it is less."""

_HELD = 1e-6
"""Inverse weight of a joint that cannot turn the view any more."""


class SimulatedView(NamedTuple):
    """What the camera sees while the arm moves; written to in each step.

    Attributes:
        axes: (3, 3) of the camera in the world, a column each.
        lens: (3,) [m].
        rows: (2, n) derivative of the error (3) over its stretch [rad].
        weights: (n,) inverse weights of the law (9).
        wanted: (n,) rates before they are bounded [rad/s or m/s].
    """

    axes: Array
    lens: Array
    rows: Array
    weights: Array
    wanted: Array

    @classmethod
    def of(cls, n: int) -> Self:
        """An empty one of `n` joints."""
        return cls(np.zeros((3, 3)), np.zeros(3), np.zeros((2, n)), np.zeros(n), np.zeros(n))


@makes_no_array
def move(
    arm: EscapingArm,
    time: float,
    focus: Array,
    goal: Array,
    q: Array,
    rates: Array,
    seen: SimulatedView,
    placed: Placed,
) -> tuple[float, float]:
    """Move `q` and `rates` (n,) by a step; returns the view's error [rad] and distance [m] before it."""
    angle, away, right, up = _look(arm, focus, seen, placed)
    for i in range(len(q)):
        way, most = goal[i] - q[i], arm.max_acceleration[i] * time
        wanted = math.copysign(min(arm.max_rate[i], math.sqrt(1.4 * arm.max_acceleration[i] * abs(way))), way)
        rates[i] = min(max(arm.leads[i] * wanted, rates[i] - most), rates[i] + most)
    turn = -_TURNS / time * min(angle, 1.0)
    _keep_view(arm, q, turn * right, turn * up, rates, seen)
    for i in range(len(q)):
        q[i] = min(max(q[i] + time * rates[i], arm.lower[i]), arm.upper[i])
    return angle, away


@inlined
def _look(
    arm: EscapingArm, focus: Array, seen: SimulatedView, placed: Placed
) -> tuple[float, float, float, float]:
    """Write to `seen`; returns the error [rad], the distance [m], and the error's direction in the picture."""
    joint, axes, lens = arm.camera_joint, seen.axes, seen.lens
    for row in range(3):
        lens[row] = placed.translation[joint, row]
        for column in range(3):
            axes[row, column] = 0.0
        for k in range(3):
            turned = placed.rotation[joint, row, k]
            lens[row] += turned * arm.camera_position[k]
            for column in range(3):
                axes[row, column] += turned * arm.camera_rotation[k, column]
    ux, uy, uz = focus[0] - lens[0], focus[1] - lens[1], focus[2] - lens[2]
    away = math.sqrt(ux * ux + uy * uy + uz * uz)
    if away > MIN_DISTANCE_M:
        ux, uy, uz = ux / away, uy / away, uz / away
    else:
        ux, uy, uz, away = axes[0, 2], axes[1, 2], axes[2, 2], MIN_DISTANCE_M
    y1 = axes[0, 0] * ux + axes[1, 0] * uy + axes[2, 0] * uz
    y2 = axes[0, 1] * ux + axes[1, 1] * uy + axes[2, 1] * uz
    y3 = axes[0, 2] * ux + axes[1, 2] * uy + axes[2, 2] * uz
    sine = math.sqrt(y1 * y1 + y2 * y2)
    angle = min(math.atan2(sine, y3), math.pi - ANTIPODE_RAD)
    right, up = (y1 / sine, y2 / sine) if sine > 1e-12 else (0.0, 1.0)
    size = math.tan(0.5 * angle)
    for row in range(2):
        psi = size * (right if row == 0 else up)
        x = (axes[0, row] - psi * (axes[0, 2] + ux)) / away
        y = (axes[1, row] - psi * (axes[1, 2] + uy)) / away
        z = (axes[2, row] - psi * (axes[2, 2] + uz)) / away
        # as a wrench at the world's origin it acts on the twists of all joints
        a, b, c = focus[1] * z - focus[2] * y, focus[2] * x - focus[0] * z, focus[0] * y - focus[1] * x
        for i in range(seen.rows.shape[1]):
            twist = placed.columns[i]
            moved = x * twist[0] + y * twist[1] + z * twist[2] + a * twist[3] + b * twist[4] + c * twist[5]
            seen.rows[row, i] = -arm.sees[i] * moved
    return angle, away, right, up


@inlined
def _keep_view(
    arm: EscapingArm, q: Array, right: float, up: float, rates: Array, seen: SimulatedView
) -> None:
    """Change `rates` so that they turn the view too; joints that cannot leave it to the others."""
    for i in range(len(q)):
        seen.weights[i] = arm.max_acceleration[i] ** 2
    _turn(right, up, rates, seen)
    is_held = False
    for i in range(len(q)):
        bounded = _bounded(arm, q, i, seen.wanted[i])
        if bounded != seen.wanted[i]:
            is_held, seen.weights[i], rates[i] = True, _HELD, bounded
    if is_held:
        _turn(right, up, rates, seen)
    for i in range(len(q)):
        rates[i] = _bounded(arm, q, i, seen.wanted[i])


@inlined
def _turn(right: float, up: float, rates: Array, seen: SimulatedView) -> None:
    """The law (9): `seen.wanted` turns the view by a rate, and is else as near to `rates` as it may be."""
    rows, weights = seen.rows, seen.weights
    a = c = 1.0  # the damping
    b = 0.0
    for i in range(len(rates)):
        one, other = weights[i] * rows[0, i], weights[i] * rows[1, i]
        a += one * rows[0, i]
        b += one * rows[1, i]
        c += other * rows[1, i]
        right -= rows[0, i] * rates[i]
        up -= rows[1, i] * rates[i]
    determinant = a * c - b * b
    x, y = (c * right - b * up) / determinant, (a * up - b * right) / determinant
    for i in range(len(rates)):
        seen.wanted[i] = rates[i] + weights[i] * (x * rows[0, i] + y * rows[1, i])


@inlined
def _bounded(arm: EscapingArm, q: Array, joint: int, rate: float) -> float:
    """A joint's rate within its limits: of speed, and of the way in which it can still brake."""
    brakes, most = 2.0 * _BRAKES * arm.max_acceleration[joint], arm.max_rate[joint]
    fastest = min(math.sqrt(brakes * max(arm.upper[joint] - q[joint], 0.0)), most)
    slowest = -min(math.sqrt(brakes * max(q[joint] - arm.lower[joint], 0.0)), most)
    bounded: float = min(max(rate, slowest), fastest)
    return bounded
