"""The cost of a candidate trajectory (a course) of the arm, simulated on a model of robot and attacker, compiled.

The arm goes to one goal and then to another, its joints as fast as speed and acceleration let them; those that the
view needs are turned by the law (9). The attacker's tool homes in on a moving point of the arm, and its bodies move
with the tool.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from deltaq_cell.anatomy import placed_at_first
from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Placed
from deltaq_controllers.camera.escape.arm import EscapingArm, clearance, least_gap, place_boxes
from deltaq_controllers.camera.escape.motion import SimulatedView, move
from deltaq_protocol.arrays import Array, Indices

# The gains of an escape.


class EscapeGains(NamedTuple):
    """Gains of the plan; costs are per step of the horizon unless said otherwise.

    Attributes:
        step_s: time between two steps of a course [s].
        steps: length of the horizon in steps.
        rivals: new courses that are tried in each cycle; each costs the same time at most.
        range_m: clearance from the attacker from which on it costs nothing [m].
        near: cost at zero clearance; it grows with the square of the shortfall to `range_m`.
        close_m: clearance below which it costs `close` more, in proportion [m].
        close: cost at zero clearance.
        contact_m: clearance below which it counts as a contact: what the model cannot tell from one [m].
        contact: cost of a contact in its step and in each later one.
        view_rad: view angle error from which on it costs [rad].
        askew: cost per rad of a greater error, bounded by that of half a rad.
        own_m: distance that the arm keeps from itself and from the structure [m].
        own: cost when touching them, in proportion to the shortfall.
        margin: part of a joint's range within which its limit costs at the end.
        limit: cost of a joint that ends at its limit, once.
        inner_m: clearance of the attacker from the bodies that cannot get out of the way, from which on it costs
            nothing at the end [m].
        inner: cost at zero clearance, once; it grows with the square of the shortfall.
        distance: cost per squared m of the view distance's error at the end, once.
        better: a rival takes over if it costs less than this part of the course that is held.
        acts_above: cost of the best course from which on it leads the arm.
        led_evasion_weight, led_weight: of the programme's rows while it leads: of each joint that it leads, and of
            distance and joint margin, which the course has weighed already.
    """

    step_s: float = 0.08
    steps: int = 25
    rivals: int = 60
    range_m: float = 0.35
    near: float = 3.0
    close_m: float = 0.12
    close: float = 10.0
    contact_m: float = 0.03
    contact: float = 60.0
    view_rad: float = 0.012
    askew: float = 10.0
    own_m: float = 0.02
    own: float = 10.0
    margin: float = 0.12
    limit: float = 0.6
    inner_m: float = 0.8
    inner: float = 30.0
    distance: float = 0.3
    better: float = 0.93
    acts_above: float = 0.3
    led_evasion_weight: float = 3e-2
    led_weight: float = 1e-4


LENS, NOTHING = -1, -2
"""Targets of an attacker's tool other than a joint's origin."""

ATTACKERS_M_S2 = 2.0
"""Acceleration that is expected of a tool [m/s^2]."""

_FADES = 0.9
"""Fraction of its velocity that a tool without a target keeps from one step to the next."""


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
    """Start of courses: `q` (n,), its `rates` (n,), the `focus` (3,) [m] and the desired `distance` [m]."""

    q: Array
    rates: Array
    focus: Array
    distance: float


class Simulation(NamedTuple):
    """Memory for the simulation of courses, so that none allocates an array.

    Attributes:
        placed: the arm, as the gate's kernel places it.
        seen: the view of its camera.
        q, rates: (n,) of the arm.
        tip, velocity: (3,) of the attacker's tool [m], [m/s].
        shift: (3,) displacement of the attacker's bodies [m].
        path: (steps, n) of the newest course [rad or m].
        best: (steps, n) of the best one.
    """

    placed: Placed
    seen: SimulatedView
    q: Array
    rates: Array
    tip: Array
    velocity: Array
    shift: Array
    path: Array
    best: Array

    @classmethod
    def of(cls, arm: EscapingArm, gains: EscapeGains) -> Self:
        """Memory for the courses of an arm."""
        n = len(arm.lower)
        tool, paths = np.zeros((3, 3)), np.zeros((2, gains.steps, n))
        return cls(
            placed_at_first(arm.boxed.anatomy), SimulatedView.of(n), np.zeros(n), np.zeros(n), *tool, *paths
        )


@makes_no_array
def best_course(
    arm: EscapingArm,
    attacker: Attacker,
    gains: EscapeGains,
    start: CourseStart,
    courses: Courses,
    simulation: Simulation,
) -> tuple[int, int, float]:
    """Find the best of several courses; the first one is kept unless another is clearly better.

    Returns:
        Number of the best, number of the best other one, and cost of the best; its path is `simulation.best`.
    """
    best, second, least = 0, 0, math.inf
    bound = math.inf
    for course in range(len(courses.until)):
        cost = course_cost(arm, attacker, gains, start, courses, course, simulation, bound)
        if course == 0 or cost < gains.better * bound - 0.03:
            best, bound = course, cost
            for step in range(gains.steps):
                for joint in range(len(start.q)):
                    simulation.best[step, joint] = simulation.path[step, joint]
        if course > 0 and cost < least:
            second, least = course, cost
    return best, second, bound


@makes_no_array
def course_cost(
    arm: EscapingArm,
    attacker: Attacker,
    gains: EscapeGains,
    start: CourseStart,
    courses: Courses,
    course: int,
    simulation: Simulation,
    bound: float,
) -> float:
    """Cost of one course, whose path is `simulation.path`; the simulation ends once the cost is above `bound`."""
    q, rates, placed, seen = simulation.q, simulation.rates, simulation.placed, simulation.seen
    for joint in range(len(q)):
        q[joint], rates[joint] = start.q[joint], start.rates[joint]
    for k in range(3):
        simulation.tip[k], simulation.velocity[k] = attacker.tip[k], attacker.velocity[k]
        simulation.shift[k] = 0.0
    place_boxes(arm.boxed, placed, q)
    cost, away, is_hit = 0.0, start.distance, False
    for step in range(gains.steps):
        goal = courses.first[course] if step < courses.until[course] else courses.then[course]
        angle, away = move(arm, gains.step_s, start.focus, goal, q, rates, seen, placed)
        for joint in range(len(q)):
            simulation.path[step, joint] = q[joint]
        place_boxes(arm.boxed, placed, q)
        _pursue(
            attacker,
            gains.step_s,
            seen.lens if attacker.target < 0 else placed.translation[attacker.target],
            simulation,
        )
        clear = _clearance(arm, arm.boxed.own, attacker, placed, simulation.shift, gains.range_m)
        is_hit = is_hit or clear < gains.contact_m
        cost += _cost_of_step(arm, gains, placed, clear, angle)
        if is_hit:
            cost += gains.contact
        if cost > bound:
            return cost
    for joint in range(len(q)):
        room = min(q[joint] - arm.lower[joint], arm.upper[joint] - q[joint])
        missing = 1.0 - room / (gains.margin * (arm.upper[joint] - arm.lower[joint]))
        cost += gains.limit * max(missing, 0.0) ** 2
    inner = _clearance(arm, arm.boxed.inner, attacker, placed, simulation.shift, gains.inner_m)
    cost += gains.inner * (1.0 - inner / gains.inner_m) ** 2
    return cost + gains.distance * (away - start.distance) ** 2


@inlined
def _pursue(attacker: Attacker, time: float, target: Array, simulation: Simulation) -> None:
    """Move the attacker's tool by a step."""
    tip, velocity, shift = simulation.tip, simulation.velocity, simulation.shift
    x, y, z = target[0] - tip[0], target[1] - tip[1], target[2] - tip[2]
    far = max(math.sqrt(x * x + y * y + z * z), 1e-9)
    toward = min(attacker.speed, math.sqrt(2.0 * ATTACKERS_M_S2 * far)) / far
    if attacker.target == NOTHING:
        x, y, z = _FADES * velocity[0], _FADES * velocity[1], _FADES * velocity[2]
        toward = 1.0
    x, y, z = toward * x - velocity[0], toward * y - velocity[1], toward * z - velocity[2]
    share = min(ATTACKERS_M_S2 * time / max(math.sqrt(x * x + y * y + z * z), 1e-9), 1.0)
    velocity[0] += share * x
    velocity[1] += share * y
    velocity[2] += share * z
    for k in range(3):
        tip[k] += time * velocity[k]
        shift[k] += time * velocity[k]


@inlined
def _clearance(
    arm: EscapingArm, bodies: Indices, attacker: Attacker, placed: Placed, shift: Array, least: float
) -> float:
    distance: float = clearance(arm.boxed, bodies, placed, attacker.centres, attacker.radii, shift, least)
    return distance


@inlined
def _cost_of_step(arm: EscapingArm, gains: EscapeGains, placed: Placed, clear: float, angle: float) -> float:
    cost = gains.near * (1.0 - clear / gains.range_m) ** 2
    cost += gains.close * max(1.0 - clear / gains.close_m, 0.0)
    if angle > gains.view_rad:
        cost += gains.askew * min(angle, 0.5)
    own = least_gap(arm.boxed, placed, gains.own_m)
    return cost + gains.own * (1.0 - own / gains.own_m)
