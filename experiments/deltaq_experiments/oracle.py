"""An independent oracle: how near bodies really came, and whether a limit was passed.

It shares nothing with the gate but the bodies and the kinematics: every recorded configuration is placed as it
is, every pair is measured, nothing is inflated or bounded. Limits are judged on the emulated controller's
record of its own setpoints, not on what a service intended to send.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import GateDescription
from deltaq_cell.robot import RobotModel

Array = NDArray[np.float64]


STRUCTURE = "structure"
"""Owner of the bodies that stand still."""


@dataclass(frozen=True)
class Near:
    """Least distance [m] over some configurations, and between which bodies."""

    distance_m: float
    pair: tuple[str, str]


class ClearanceOracle:
    """Measures every pair of bodies of a cell at given configurations.

    Args:
        cell: the cell.
    """

    def __init__(self, cell: CellModel) -> None:
        self._robots = cell.robots
        self._data = {name: robot.model.createData() for name, robot in cell.robots.items()}
        self._robot_geometry = {name: robot.geometry for name, robot in cell.robots.items()}
        self._robot_data = {name: robot.geometry.createData() for name, robot in cell.robots.items()}
        self._all = pin.GeometryModel()
        self._owner: list[tuple[str, int]] = []
        for name, robot in cell.robots.items():
            for index, body in enumerate(robot.geometry.geometryObjects):
                self._add(body, name, index)
        for index, body in enumerate(cell.structure):
            self._add(body, STRUCTURE, index)
        self._structure = [body.placement for body in cell.structure]
        never = {frozenset(p) for robot in cell.robots.values() for p in robot.never_checked_pairs()}
        self._foreign = self._pairs(never, lambda one, other: one != other)
        self._own = self._pairs(never, lambda one, other: one == other != STRUCTURE)
        self._robot_pairs = self._pairs(
            never, lambda one, other: one != other and STRUCTURE not in (one, other)
        )
        self._watched = [
            (pairs, list(range(len(pairs[0].collisionPairs)))) for pairs in (self._foreign, self._own)
        ]

    def between_robots_and_structure(self, configurations: Mapping[str, Array]) -> Near:
        """Least distance between robots, and between robots and structure; (n,) [rad or m] per robot."""
        return self._least(self._foreign, configurations)

    def between_robots(self, configurations: Mapping[str, Array]) -> Near:
        """Least distance between bodies of two robots; (n,) [rad or m] per robot."""
        return self._least(self._robot_pairs, configurations)

    def of_one_robot(self, configurations: Mapping[str, Array]) -> Near:
        """Least distance between two bodies of one robot; (n,) [rad or m] per robot."""
        return self._least(self._own, configurations)

    def distances(self, configurations: Mapping[str, Array]) -> Array:
        """(pairs,) distance of every pair that is watched, always in the same order [m]."""
        found = []
        for pairs, watched in self._watched:
            self._least(pairs, configurations)
            results = pairs[1].distanceResults
            found.append([results[index].min_distance for index in watched])
        return np.concatenate(found)

    def stop_distances(self, gate: GateDescription) -> Array:
        """(pairs,) least distance that each pair of `distances` has to keep [m]."""
        stops = (gate.stop_distance_m, gate.self_stop_distance_m)
        return np.repeat(stops, [len(watched) for _, watched in self._watched])

    def watch(self, distance_m: float, *configurations: Mapping[str, Array]) -> None:
        """From now on measure only pairs that are nearer than a distance in one of these configurations."""
        watched = []
        for pairs in (self._foreign, self._own):
            data = pairs[1]
            for index in range(len(pairs[0].collisionPairs)):
                data.activateCollisionPair(index)
            near: set[int] = set()
            for where in configurations:
                self._least(pairs, where)
                near |= {
                    index
                    for index, result in enumerate(data.distanceResults)
                    if result.min_distance < distance_m
                }
            for index in set(range(len(pairs[0].collisionPairs))) - near:
                data.deactivateCollisionPair(index)
            watched.append((pairs, sorted(near)))
        self._watched = watched

    def _add(self, body: pin.GeometryObject, owner: str, index: int) -> None:
        self._all.addGeometryObject(pin.GeometryObject(body.name, 0, body.placement, body.geometry))
        self._owner.append((owner, index))

    def _pairs(
        self, never: set[frozenset[str]], wanted: Callable[[str, str], bool]
    ) -> tuple[pin.GeometryModel, pin.GeometryData]:
        geometry = pin.GeometryModel()
        for body in self._all.geometryObjects:
            geometry.addGeometryObject(body)
        names = [body.name for body in self._all.geometryObjects]
        for i, (owner, _) in enumerate(self._owner):
            for j in range(i + 1, len(names)):
                if wanted(owner, self._owner[j][0]) and frozenset((names[i], names[j])) not in never:
                    geometry.addCollisionPair(pin.CollisionPair(i, j))
        return geometry, geometry.createData()

    def _least(
        self, pairs: tuple[pin.GeometryModel, pin.GeometryData], configurations: Mapping[str, Array]
    ) -> Near:
        geometry, data = pairs
        for name, q in configurations.items():
            robot, robot_data = self._robots[name], self._robot_data[name]
            pin.updateGeometryPlacements(robot.model, self._data[name], robot.geometry, robot_data, q)
        for place, (owner, index) in enumerate(self._owner):
            data.oMg[place] = (
                self._structure[index] if owner == STRUCTURE else self._robot_data[owner].oMg[index]
            )
        if not len(geometry.collisionPairs):
            return Near(np.inf, ("", ""))
        nearest = pin.computeDistances(geometry, data)
        pair = geometry.collisionPairs[nearest]
        names = (geometry.geometryObjects[pair.first].name, geometry.geometryObjects[pair.second].name)
        return Near(data.distanceResults[nearest].min_distance, names)


@dataclass(frozen=True)
class LimitViolations:
    """How many joints of how many cycles were beyond a limit."""

    position: int
    velocity: int
    acceleration: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.position + self.velocity + self.acceleration

    def __add__(self, other: LimitViolations) -> LimitViolations:
        """Those of two robots together."""
        return LimitViolations(
            self.position + other.position,
            self.velocity + other.velocity,
            self.acceleration + other.acceleration,
        )


TELEGRAM_STEP = 1e-6 * np.pi / 180
"""Rounding of a setpoint to six decimals of a degree [rad]; of a millimetre it is less [m]."""


def limit_violations(robot: RobotModel, setpoints: Array, cycle_s: float) -> LimitViolations:
    """Count where consecutive setpoints pass a limit by more than the telegram's decimals explain.

    Args:
        robot: whose limits count.
        setpoints: (cycles, n) the emulated controller's setpoints [rad or m].
        cycle_s: time between two of them.
    """
    position = (setpoints < robot.lower - TELEGRAM_STEP) | (setpoints > robot.upper + TELEGRAM_STEP)
    steps = np.diff(setpoints, axis=0)
    velocity = np.abs(steps) > robot.max_velocity * cycle_s + 2 * TELEGRAM_STEP
    changes = np.diff(steps, axis=0)
    acceleration = np.abs(changes) > robot.max_acceleration * cycle_s**2 + 4 * TELEGRAM_STEP
    return LimitViolations(int(position.sum()), int(velocity.sum()), int(acceleration.sum()))
