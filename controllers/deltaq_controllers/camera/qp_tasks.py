"""The tasks of the quadratic programme, compiled: rows, what they should change in this cycle, and their weights."""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.camera.error import CameraPose, look_on, view_jacobians
from deltaq_controllers.camera.qp_gains import QpGains
from deltaq_controllers.camera.subtasks import RollJoint, roll_effects, turn_to_level
from deltaq_controllers.vectors import solved
from deltaq_protocol.arrays import Array


class Aim(NamedTuple):
    """Where the focus will be (3,) in the world [m], its velocity (3,) [m/s], and the desired view distance [m]."""

    focus: Array
    velocity: Array
    desired_distance: float


class Tasks(NamedTuple):
    """Least squares of the programme.

    Attributes:
        rows: (t, n) change of each task per increment.
        wanted: (t,) change asked for [rad or m].
        weights: (t,) cost of a squared mrad or mm.
    """

    rows: Array
    wanted: Array
    weights: Array


class Evasion(NamedTuple):
    """How the arm gets out of another robot's way.

    Attributes:
        rows: (k, n) directions in which its joints move, of unit length.
        rates: (k,) along each [rad/s or m/s]; zero for none.
        room: (n,) that move joints away from their limits [rad/s or m/s]; zero for none.
    """

    rows: Array
    rates: Array
    room: Array


class TaskGains(NamedTuple):
    """The fields of `QpGains` that the tasks use: each argument costs time."""

    angle_weight: float
    evasion_weight: float
    distance_weight: float
    room_weight: float
    roll_weight: float
    angle_share: float
    distance_share: float
    roll_share: float
    brake_share: float
    zoom_m_s2: float
    spin_rad_s2: float

    @classmethod
    def of(cls, gains: QpGains) -> Self:
        """The choice from all of them."""
        return cls(*(getattr(gains, name) for name in cls._fields))


@compiled
def view_tasks(
    pose: CameraPose,
    q: Array,
    aim: Aim,
    evasion: Evasion,
    gains: TaskGains,
    roll_joint: RollJoint,
    max_ddq: Array,
    cycle_s: float,
) -> Tasks:
    """Angle (two rows), distance, roll, a row for each direction of the evasion, and room.

    Args:
        pose: of the camera.
        q: (n,) configuration [rad or m].
        aim: what to look at.
        evasion: how to get out of the way.
        gains: weights and shares.
        roll_joint: the joint that levels the picture.
        max_ddq: (n,) largest change of the increment between two cycles [rad or m].
        cycle_s: the cycle [s].
    """
    view = look_on(pose.rotation, pose.position, aim.focus, pose.twists)
    jacobian, approach = view_jacobians(view, pose.position, aim.focus, pose.twists)
    room, ways = evasion.room, len(evasion.rates)
    pull = math.sqrt((room * room).sum())
    rows = np.empty((5 + ways, len(q)))
    rows[:2], rows[2] = jacobian / view.stretch, -approach
    rows[3] = roll_effects(pose.rotation, pose.twists[3:])
    rows[4:-1], rows[-1] = evasion.rows, room / max(pull, 1e-9)

    deceleration = available(rows[:2], max_ddq, view.direction)
    turn = step(view.angle, gains.angle_share, deceleration, gains.brake_share)
    wanted = np.empty(5 + ways)
    for i in range(2):
        drift = (view.P[i] * aim.velocity).sum() * cycle_s / view.stretch
        wanted[i] = -turn * view.direction[i] - drift

    error = view.distance - aim.desired_distance
    # with the view direction kept
    deceleration = available(rows[:3], max_ddq, np.array([0.0, 0.0, 1.0]))
    deceleration = min(deceleration, gains.zoom_m_s2 * cycle_s**2)
    zoom = step(abs(error), gains.distance_share, deceleration, gains.brake_share)
    wanted[2] = -math.copysign(zoom, error) - cycle_s * (view.u * aim.velocity).sum()

    last = roll_joint.number
    axis = pose.twists[3:, last]
    turn = turn_to_level(pose.rotation, axis, q[last], roll_joint.lower, roll_joint.upper) * rows[3, last]
    level = step(abs(turn), gains.roll_share, gains.spin_rad_s2 * cycle_s**2, gains.brake_share)
    wanted[3] = math.copysign(level, turn)
    wanted[4:-1], wanted[-1] = cycle_s * evasion.rates, cycle_s * pull

    weights = np.empty(5 + ways)
    weights[:2], weights[2], weights[3] = gains.angle_weight, gains.distance_weight, gains.roll_weight
    weights[4:-1], weights[-1] = gains.evasion_weight, gains.room_weight
    return Tasks(rows, wanted, weights)


@compiled
def step(error: float, share: float, deceleration: float, brake_share: float) -> float:
    """A fraction of an error, but not more than can be braked within the remaining error."""
    return min(share * error, math.sqrt(2.0 * brake_share * deceleration * error))


@compiled
def available(rows: Array, max_ddq: Array, direction: Array) -> float:
    """Largest change of a task per cycle and cycle along a direction that the joints' acceleration allows.

    The joints share the work in proportion to their acceleration limits, least squares.

    Args:
        rows: (t, n) change of the task by the joints.
        max_ddq: (n,) largest change of the increment between two cycles [rad or m].
        direction: (t,) unit vector.
    """
    scaled = rows * max_ddq
    square = np.zeros((len(rows), len(rows)))
    for i in range(len(rows)):
        for j in range(len(rows)):
            square[i, j] = (scaled[i] * scaled[j]).sum()
        # a direction that no joint moves has no acceleration, and no infinity either
        square[i, i] += 1e-12
    shares, busiest = solved(square, direction), 1e-9
    for joint in range(len(max_ddq)):
        busiest = max(busiest, abs((shares * scaled[:, joint]).sum()))
    return 1.0 / busiest
