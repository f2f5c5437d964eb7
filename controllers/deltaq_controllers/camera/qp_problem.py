"""One quadratic programme per cycle, over the robot's increment and a slack for each kind of barrier.

    minimise    sum_i w_i |A_i dq - b_i|^2 + rest |dq / ddq_max|^2 + price . s
    subject to  slowest <= dq <= fastest,  C dq + S s >= c,  s >= 0

S picks the slack of each barrier's kind, so that slack of one kind does not loosen the others. The programme
always has a solution: `slowest <= fastest` leaves at least the brake, and s takes up whatever the barriers demand
beyond it. The solver is DAQP's dual active-set method (Arnström, Bemporad and Axehill, 2022, IEEE TAC 67(8)): exact
to rounding for programmes of this size, and with no state carried from one cycle to the next, so that the same view
gives the same increment, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import daqp
import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.camera.error import CameraPose, look_on, view_jacobians
from deltaq_controllers.camera.subtasks import RollJoint, roll_effects, turn_to_level
from deltaq_controllers.redundancy import DEGREES
from deltaq_controllers.surroundings.barriers import Barriers
from deltaq_controllers.vectors import solved
from deltaq_protocol.arrays import Array

# Weights and margins.


class QpGains(NamedTuple):
    """Gains of the programme, in order of priority.

    Limits of speed, acceleration and position are constraints without slack: nothing outweighs them. Then come
    the barriers, whose slack costs in proportion (`barrier_price`), so that the camera cannot buy any of it
    while there is an alternative. The tasks are least squares in one sum. Angle comes first, at a higher price than
    the braking distance of others; two decades below it evasion, distance and joint margin, of equal weight: the
    follower backs off neither along the view axis nor into a limit while it can evade sideways. Two decades below
    that roll, and the joint margin where no robot is near: without it the freedom that the view leaves drifts into
    limits, from which a later change of distance finds no way. Last of all rest of the joints.

    Attributes:
        clear_of_others_m: least distance from other robots, beyond the gate's stop distance [m].
        clear_of_structure_m: least distance from the structure, likewise [m].
        clear_of_self_m: least distance between the robot's own bodies, beyond the gate's for these [m].
        barrier_range_m: beyond its barrier, how far a pair of bodies is taken into account [m].
        others_range_m: this range for bodies of other robots [m].
        barrier_share: fraction of the remaining distance that one cycle may use up.
        others_share: this fraction for other robots; smaller, so that evading begins early and gently.
        reaction_s: time for which another robot is expected to keep its speed [s].
        others_brake_m_s2: deceleration that is expected of another robot [m/s^2].
        barrier_price: cost of slack per m, on the scale of the tasks' costs; above what the largest error can pay.
        reserve_price: this cost for the braking distance of other robots, beyond the least distance from them.
        evasion: eta of the repulsion (12) off other robots [m^3 rad/s].
        evasion_range_m: rho_0 of (12) [m].
        evasion_min_m: distance at which the repulsion stops growing [m].
        limit_scale: s_w of the weights (10) that keep the repulsion from pressing joints to their limits [rad].
        room: k of the rates -k H, H of (11), at which joints leave their limits [rad^2/s or m^2/s].
        room_rate: largest size of these rates [rad/s or m/s].
        angle_weight, evasion_weight, distance_weight, room_weight, posture_weight, roll_weight, rest_weight: of the
            squares: per mm of the focus' path at 1 m for angle, per mrad for evasion, room, posture and roll, per mm
            for distance, per acceleration limit for rest. The joints' margin weighs `room_weight` while another robot
            is near, and else `posture_weight`.
        angle_share, distance_share, roll_share: part of an error that a cycle takes away, near the goal.
        brake_share: part of the possible deceleration that approaching a goal counts on.
        zoom_m_s2: largest deceleration of the view distance that is counted on [m/s^2].
        spin_rad_s2: deceleration of the roll that is counted on [rad/s^2].
    """

    clear_of_others_m: float = 0.05
    clear_of_structure_m: float = 0.03
    clear_of_self_m: float = 0.01
    barrier_range_m: float = 0.25
    others_range_m: float = 0.5
    barrier_share: float = 0.2
    others_share: float = 0.06
    reaction_s: float = 0.2
    others_brake_m_s2: float = 2.0
    barrier_price: float = 1e7
    reserve_price: float = 3e3
    evasion: float = 1e-2
    evasion_range_m: float = 0.3
    evasion_min_m: float = 0.03
    limit_scale: float = DEGREES
    room: float = 0.04
    room_rate: float = 0.7
    angle_weight: float = 1.0
    evasion_weight: float = 1e-2
    distance_weight: float = 1e-2
    room_weight: float = 1e-2
    posture_weight: float = 1e-4
    roll_weight: float = 1e-4
    rest_weight: float = 1e-5
    angle_share: float = 0.5
    distance_share: float = 0.3
    roll_share: float = 0.15
    brake_share: float = 0.6
    zoom_m_s2: float = 3.0
    spin_rad_s2: float = 30.0


# The tasks of the programme: rows of least squares.


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
        aim: the target.
        evasion: direction and rate of the evasion.
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


_MILLI = 1e3
"""Costs count in mm and mrad, so that the solver's numbers are near one."""

_UNBOUNDED = 1e30
"""The solver's value for no bound."""

_SLACK_SCALE = 1e-2
"""The slack's unit [m]: its numbers are then of the size of the others'."""


class QuadraticProgram:
    """The programme of one robot.

    Args:
        scale: (n,) unit of each increment, its acceleration limit over a cycle [rad or m].
        rest_weight: cost of the squared increments in these units.
        prices: (m,) cost of the slack of each kind of barrier [1/m].
    """

    def __init__(self, scale: Array, rest_weight: float, prices: Sequence[float]) -> None:
        n, m = len(scale), len(prices)
        self._scale, self._rest_weight = scale, rest_weight
        self._hessian = np.zeros((n + m, n + m))
        self._linear = np.zeros(n + m)
        price = np.array(prices) * _SLACK_SCALE
        # the slacks' own squares keep the programme strictly convex
        self._hessian[n:, n:] = np.diag(1e-6 * price)
        self._linear[n:] = price

    def solve(
        self,
        tasks: Tasks,
        slowest: Array,
        fastest: Array,
        barriers: Barriers,
    ) -> tuple[Array, Array] | None:
        """The best increment, and the slacks that it needs.

        Args:
            tasks: weighted rows.
            slowest: (n,) least increment [rad or m].
            fastest: (n,) greatest increment [rad or m].
            barriers: constraints to keep; their kinds are indices of `prices`.

        Returns:
            (n,) increment within its bounds and (m,) slacks [m]; None if the solver found none.
        """
        n = len(self._scale)
        _cost(tasks, self._scale, self._rest_weight, self._hessian, self._linear)
        rows, low, high = _constraints(self._scale, len(self._linear), slowest, fastest, barriers)
        solution, _, found, _ = daqp.solve(self._hessian, self._linear, rows, high, low)
        if found != 1 or not np.isfinite(solution).all():  # rounding made it inconsistent
            return None
        dq = np.minimum(np.maximum(self._scale * solution[:n], slowest), fastest)
        return dq, np.maximum(_SLACK_SCALE * solution[n:], 0.0)


@compiled
def _cost(tasks: Tasks, scale: Array, rest_weight: float, hessian: Array, linear: Array) -> None:
    """Write the tasks' cost into `hessian` (n + m, n + m) and `linear` (n + m,), which know the slacks' already."""
    for i in range(len(scale)):
        linear[i] = 0.0
        for j in range(len(scale)):
            hessian[i, j] = 2.0 * rest_weight if i == j else 0.0
    for task in range(len(tasks.weights)):
        scaled = tasks.rows[task] * scale
        heavy = (2.0 * tasks.weights[task] * _MILLI**2) * scaled
        for i in range(len(scale)):
            linear[i] -= heavy[i] * tasks.wanted[task]
            for j in range(len(scale)):
                hessian[i, j] += heavy[i] * scaled[j]


@compiled
def _constraints(
    scale: Array, count: int, slowest: Array, fastest: Array, barriers: Barriers
) -> tuple[Array, Array, Array]:
    """Rows of the barriers, and bounds of the increments, the slacks and the barriers, in this order.

    Returns:
        (k, count) rows, and (count + k,) least and greatest values; `count` is n + m.
    """
    n, least, kinds = len(scale), barriers.least, barriers.kinds
    rows = np.zeros((len(least), count))
    low, high = np.zeros(count + len(least)), np.full(count + len(least), _UNBOUNDED)
    for i in range(n):
        low[i], high[i] = slowest[i] / scale[i], fastest[i] / scale[i]
    for k in range(len(least)):
        rows[k, :n] = barriers.rows[k] * scale / _SLACK_SCALE
        rows[k, n + kinds[k]] = 1.0
        low[count + k] = least[k] / _SLACK_SCALE
    return rows, low, high
