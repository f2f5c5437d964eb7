"""The cost of a course of the arm, simulated on a model of the robot and of its attacker, compiled.

The arm goes to one goal and then to another, its joints as fast as speed and acceleration let them; those that the
view needs are turned by the law (9). The attacker's tool homes in on a point of the arm, however that moves, and its
bodies go where the tool goes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_cell.kernel.arrays import Placed
from deltaq_controllers.camera.error import look, view_jacobians
from deltaq_controllers.camera.escape.arm import EscapingArm
from deltaq_controllers.camera.escape.distances import clearance, least_gap, place_boxes
from deltaq_controllers.camera.escape.gains import EscapeGains
from deltaq_controllers.redundancy import damped_rates
from deltaq_protocol.arrays import Array, Indices

LENS, NOTHING = -1, -2
"""Targets of an attacker's tool other than a joint's origin."""

ATTACKERS_M_S2 = 2.0
"""Acceleration that is expected of a tool [m/s^2]."""

_FADES = 0.9
"""Fraction of its velocity that a tool without a target keeps from one step to the next."""

_TURNS = 0.5
"""Fraction of the view's error that one step removes."""

_BRAKES = 0.8
"""Fraction of its deceleration that a joint uses before its limit; before a goal it is less."""


class Attacker(NamedTuple):
    """The robot that the arm escapes from.

    Attributes:
        centres: (m, 3) of the spheres around its bodies [m].
        radii: (m,) [m].
        tip: (3,) its tool [m].
        velocity: (3,) of the tool [m/s].
        speed: greatest speed that it may reach [m/s].
        target: number of the joint whose origin it is after; or `LENS`, or `NOTHING`.
    """

    centres: Array
    radii: Array
    tip: Array
    velocity: Array
    speed: float
    target: int


class Courses(NamedTuple):
    """Courses of the arm: each goes to `first` (k, n) for so many steps, `until` (k,), and `then` (k, n)."""

    first: Array
    until: Indices
    then: Array


class CourseStart(NamedTuple):
    """Where courses begin: `q` (n,), its `rates` (n,), the `focus` (3,) [m] and the desired `distance` [m]."""

    q: Array
    rates: Array
    focus: Array
    distance: float


@compiled
def best_course(
    arm: EscapingArm,
    attacker: Attacker,
    gains: EscapeGains,
    start: CourseStart,
    courses: Courses,
    placed: Placed,
    paths: Array,
) -> tuple[int, int, float]:
    """The best of some courses; the first one is held unless another is clearly better.

    Returns:
        Number of the best, of the best of the others, and what the first costs. `paths[0]` (steps, n) is its way.
    """
    best, second, least = 0, 0, math.inf
    bound = math.inf
    for course in range(len(courses.until)):
        cost = course_cost(arm, attacker, gains, start, courses, course, placed, paths[1], bound)
        if course == 0 or cost < gains.better * bound - 0.03:
            best, bound = course, cost
            paths[0] = paths[1]
        if course > 0 and cost < least:
            second, least = course, cost
    return best, second, bound


@compiled
def course_cost(
    arm: EscapingArm,
    attacker: Attacker,
    gains: EscapeGains,
    start: CourseStart,
    courses: Courses,
    course: int,
    placed: Placed,
    path: Array,
    bound: float,
) -> float:
    """Cost of one course; once it is above `bound` the rest is not looked at. `path` (steps, n) is written to."""
    q, rates = start.q.copy(), start.rates.copy()
    tip, velocity, shift = attacker.tip.copy(), attacker.velocity.copy(), np.zeros(3)
    place_boxes(arm.boxed, placed, q)
    cost, away = 0.0, start.distance
    for step in range(gains.steps):
        goal = courses.first[course] if step < courses.until[course] else courses.then[course]
        angle, away, lens = _move(arm, gains.step_s, start.focus, goal, q, rates, placed)
        path[step] = q
        place_boxes(arm.boxed, placed, q)
        target = lens if attacker.target < 0 else placed.translation[attacker.target]
        _pursue(attacker, gains.step_s, target, tip, velocity, shift)
        cost += _cost_of_step(arm, attacker, gains, placed, shift, angle)
        if cost > bound:
            return cost
    for joint in range(len(q)):
        room = min(q[joint] - arm.lower[joint], arm.upper[joint] - q[joint])
        missing = 1.0 - room / (gains.margin * (arm.upper[joint] - arm.lower[joint]))
        cost += gains.limit * max(missing, 0.0) ** 2
    return cost + gains.distance * (away - start.distance) ** 2


@compiled
def _move(
    arm: EscapingArm, time: float, focus: Array, goal: Array, q: Array, rates: Array, placed: Placed
) -> tuple[float, float, Array]:
    """Move `q` and `rates` (n,) by a step; the view's error [rad] and distance [m] and the lens (3,) [m] before it."""
    joint = arm.camera_joint
    rotation, lens = np.zeros((3, 3)), placed.translation[joint].copy()
    # a compiled `@` would need scipy, which an installed deltaq does not have
    for row in range(3):
        for k in range(3):
            turned = placed.rotation[joint, row, k]
            lens[row] += turned * arm.camera_position[k]
            for column in range(3):
                rotation[row, column] += turned * arm.camera_rotation[k, column]
    view = look(rotation, lens, focus)
    twists = np.empty((6, len(q)))
    for i in range(len(q)):
        for axis in range(6):
            twists[axis, i] = arm.sees[i] * placed.columns[i, axis]
    rows = view_jacobians(view, lens, focus, twists)[0] / view.stretch
    for i in range(len(q)):
        way, most = goal[i] - q[i], arm.max_acceleration[i] * time
        wanted = math.copysign(min(arm.max_rate[i], math.sqrt(1.4 * arm.max_acceleration[i] * abs(way))), way)
        rates[i] = min(max(arm.leads[i] * wanted, rates[i] - most), rates[i] + most)
    rates[:] = _with_view(arm, q, rows, (-_TURNS / time * min(view.angle, 1.0)) * view.direction, rates)
    for i in range(len(q)):
        q[i] = min(max(q[i] + time * rates[i], arm.lower[i]), arm.upper[i])
    return view.angle, view.distance, lens


@compiled
def _with_view(arm: EscapingArm, q: Array, rows: Array, turn: Array, rates: Array) -> Array:
    """(n,) rates that also turn the view by `turn` (2,); joints that cannot leave it to the others."""
    room_above, room_below = np.maximum(arm.upper - q, 0.0), np.maximum(q - arm.lower, 0.0)
    fastest = np.minimum(np.sqrt(2.0 * _BRAKES * arm.max_acceleration * room_above), arm.max_rate)
    slowest = -np.minimum(np.sqrt(2.0 * _BRAKES * arm.max_acceleration * room_below), arm.max_rate)
    inverse = arm.max_acceleration**2
    wanted = damped_rates(rows, inverse, turn, rates / inverse, 1.0)
    bounded = np.minimum(np.maximum(wanted, slowest), fastest)
    held = bounded != wanted
    if not held.any():
        return bounded
    inverse = np.where(held, 1e-6, inverse)
    wanted = damped_rates(rows, inverse, turn, np.where(held, bounded, rates) / inverse, 1.0)
    return np.minimum(np.maximum(wanted, slowest), fastest)


@compiled
def _pursue(
    attacker: Attacker, time: float, target: Array, tip: Array, velocity: Array, shift: Array
) -> None:
    """Move the attacker's `tip`, its `velocity` and its `shift` since the start (3,) by a step."""
    wanted = _FADES * velocity
    if attacker.target != NOTHING:
        way = target - tip
        far = max(math.sqrt((way * way).sum()), 1e-9)
        wanted = (min(attacker.speed, math.sqrt(2.0 * ATTACKERS_M_S2 * far)) / far) * way
    change, most = wanted - velocity, ATTACKERS_M_S2 * time
    size = math.sqrt((change * change).sum())
    velocity += change * (min(most / max(size, 1e-9), 1.0))
    tip += time * velocity
    shift += time * velocity


@compiled
def _cost_of_step(
    arm: EscapingArm, attacker: Attacker, gains: EscapeGains, placed: Placed, shift: Array, angle: float
) -> float:
    cost = 0.0
    away = clearance(arm.boxed, placed, attacker.centres, attacker.radii, shift, gains.range_m)
    cost += gains.near * (1.0 - away / gains.range_m) ** 2
    cost += gains.close * max(1.0 - away / gains.close_m, 0.0)
    if away < 0.0:
        cost += gains.contact
    if angle > gains.view_rad:
        cost += gains.askew * min(angle, 0.5)
    own = least_gap(arm.boxed, placed, gains.own_m)
    return cost + gains.own * (1.0 - own / gains.own_m)
