"""Situations for the gate's retreat: a robot inside a violation or just outside one, beside robots that move or stand.

Each is constructed from a seed without asking the gate: a robot is drawn somewhere, and moved along a random line of
joint space until an oracle measures the distance that was drawn.
"""

from dataclasses import dataclass

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_travel
from deltaq_testing.oracle import ClearanceOracle

DEEPEST_M = 0.03
"""Largest depth inside the stop distance at which a situation begins."""

_MOVING = 0.4
"""Fraction of situations in which the other robot is in motion."""

_REACH = 0.6
"""Length of the line along which a robot is moved, as a fraction of its joints' ranges."""

_STEPS = 40


@dataclass(frozen=True)
class Situation:
    """Where robots are when a retreat begins.

    Attributes:
        robot: the one that asks.
        q: per robot its setpoint (n,) [rad or m].
        dq: per robot the increment (n,) with which it came there; zero where it stands.
        room_m: clearance beyond the stop distance that was drawn.
    """

    robot: str
    q: dict[str, Array]
    dq: dict[str, Array]
    room_m: float


def situation(
    cell: CellModel, oracle: ClearanceOracle, random: np.random.Generator, attempts: int = 1000
) -> Situation:
    """Draw a situation.

    Raises:
        RuntimeError: if none was found in this number of attempts.
    """
    names = list(cell.robots)
    for _ in range(attempts):
        robot = names[int(random.integers(len(names)))]
        q = {name: _somewhere(model, random) for name, model in cell.robots.items()}
        dq = {name: np.zeros(model.n) for name, model in cell.robots.items()}
        for other in names:
            if other != robot and random.uniform() < _MOVING:
                dq[other] = _increment(cell.robots[other], cell.description.cycle_s, random)
        room_m = _room(random)
        found = _with_room(cell, oracle, robot, q, dq, room_m, random)
        if found is not None:
            return Situation(robot, q | {robot: found}, dq, room_m)
    raise RuntimeError(f"no situation in {attempts} attempts; does this cell have anything to come near to?")


def _room(random: np.random.Generator) -> float:
    kind = random.uniform()
    if kind < 0.5:
        return -float(random.uniform(0.0, DEEPEST_M))
    if kind < 0.75:
        return float(random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(-6, -3))
    return float(random.uniform(0.0, 0.012))


def _somewhere(robot: RobotModel, random: np.random.Generator) -> Array:
    near_home = robot.home + random.uniform(-1, 1, robot.n) * 0.35 * (robot.upper - robot.lower)
    return np.clip(near_home, robot.lower, robot.upper)


def _increment(robot: RobotModel, cycle_s: float, random: np.random.Generator) -> Array:
    fastest = robot.max_velocity * cycle_s
    return random.uniform(-1, 1, robot.n) * fastest * random.uniform(0.02, 0.6)


def _with_room(
    cell: CellModel,
    oracle: ClearanceOracle,
    robot: str,
    q: dict[str, Array],
    dq: dict[str, Array],
    room_m: float,
    random: np.random.Generator,
) -> Array | None:
    """Where `robot` has that room, between a place with more and one with less; None if its line has neither."""
    model, gate = cell.robots[robot], cell.description.gate
    cycle_s = cell.description.cycle_s
    courses = {
        name: _course(cell.robots[name], cycle_s, q[name], dq[name])
        for name in q
        if name != robot and dq[name].any()
    }

    def room(place: Array) -> float:
        where = q | {robot: place}
        own = oracle.of_one_robot(where).distance_m - gate.self_stop_distance_m
        rest = [oracle.between_robots_and_structure(where)]
        for other, course in courses.items():
            rest += [oracle.between_robots(where | {other: there}) for there in course]
        return min(own, min(near.distance_m for near in rest) - gate.stop_distance_m)

    line = random.normal(size=model.n) * _REACH * (model.upper - model.lower) / _STEPS
    far, near = q[robot], None
    if room(far) <= max(room_m, 0.0) + 1e-3:
        return None  # someone else is too near already, or this robot
    for step in range(1, _STEPS + 1):
        place = np.clip(q[robot] + step * line, model.lower, model.upper)
        if room(place) < room_m:
            near = place
            break
        far = place
    if near is None:
        return None
    for _ in range(40):
        middle = (far + near) / 2
        far, near = (middle, near) if room(middle) >= room_m else (far, middle)
    return far


def _course(robot: RobotModel, cycle_s: float, q: Array, dq: Array) -> Array:
    """(5, n) samples of a robot's braking path."""
    travel = brake_travel(dq, brake_cycles(dq, robot.max_acceleration * cycle_s**2), 0)
    return np.linspace(q, q + travel, 5)
