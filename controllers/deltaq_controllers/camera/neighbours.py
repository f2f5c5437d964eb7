"""Which bodies of a cell are near a robot, how near, and how its joints and the others' change that.

All robots of the cell are one pinocchio model, so that the rate of a distance is one row over all joints: with n
the unit vector from the other body's nearest point b to the own body's nearest point a,

    d' = n . (J_a(a) - J_b(b)) q'

where q' holds the rates of every robot. Pairs that bounding spheres keep apart are not measured, nor are pairs
that were far apart when last measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import make_reproducible
from deltaq_cell.joined import WORLD, joined
from deltaq_controllers.spheres import local_box

Array = NDArray[np.float64]
Index = NDArray[np.intp]

CLOSING_SPEED_M_S = 5.0
"""No two bodies approach one another faster: a far pair is not measured again until it can be near [m/s]."""


@dataclass(frozen=True)
class Near:
    """Pairs of bodies in range, nearest first.

    Attributes:
        pairs: (k,) index of each in `Neighbours.names`.
        distance: (k,) their distance, negative where they overlap [m].
        own: (k, n) change of the distance per increment of the own joints.
        others: (k, m) change per increment of the joints of all robots of the cell, the own ones zero.
    """

    pairs: Index
    distance: Array
    own: Array
    others: Array


class Neighbours:
    """Measures how near a robot's bodies are to everything else and to one another.

    Args:
        cell: the cell.
        robot: name of the robot.
        cycle_s: time between two measurements of one motion [s]; 0 for configurations that have nothing to do with
            each other, of which every pair is measured.
        most: how many pairs are told.

    Attributes:
        names: pair of body names by index.
        foreign: (p,) whether the pair's other body belongs to another robot.
        same: (p,) whether both bodies belong to the robot.
    """

    def __init__(self, cell: CellModel, robot: str, cycle_s: float, most: int = 10) -> None:
        self._model, places = joined(cell)
        self._data = self._model.createData()
        self._most = most
        first, n = places[robot].first_q, cell.robots[robot].n
        self._own_joints = slice(first, first + n)
        self._geometry, self._spheres = pin.GeometryModel(), pin.GeometryModel()
        self._radii: list[float] = []
        own: list[int] = []
        foreign: list[int] = []
        standing: list[int] = []
        for name, model in cell.robots.items():
            for body in model.geometry.geometryObjects:
                index = self._add(places[name].moved(body))
                (standing if body.parentJoint == WORLD else own if name == robot else foreign).append(index)
        for body in cell.structure:
            standing.append(self._add(body))
        never = {frozenset(pair) for model in cell.robots.values() for pair in model.never_checked_pairs()}
        pairs = [(i, j) for i in own for j in (*foreign, *standing)]
        pairs += list(combinations(own, 2))
        names = [body.name for body in self._geometry.geometryObjects]
        checked = np.array([frozenset((names[i], names[j])) not in never for i, j in pairs])
        self._bodies = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        self.names = tuple((names[i], names[j]) for i, j in pairs)
        self._one, self._other = self._bodies.T.copy()
        self.foreign = np.isin(self._bodies[:, 1], foreign)
        self.same = np.isin(self._bodies[:, 1], own)
        for i, j in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._geometry_data, self._sphere_data = self._geometry.createData(), self._spheres.createData()
        make_reproducible(self._geometry_data)
        radii = np.array(self._radii)
        self._reach = radii[self._bodies].sum(axis=1)
        self._moves = self._moves_of([body.parentJoint for body in self._geometry.geometryObjects])
        self._cycle, self._step_m = 0, CLOSING_SPEED_M_S * cycle_s
        self._due = np.where(checked, 0, np.iinfo(np.intp).max)
        self._split_spheres()

    def near(self, q: Array, ranges: Array) -> Near:
        """What is near at a configuration.

        Args:
            q: (m,) joints of all robots of the cell, in its order [rad or m].
            ranges: (p,) distance of each pair from which on it matters [m].
        """
        pin.computeJointJacobians(self._model, self._data, q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data)
        self._cycle += 1
        candidates = self._candidates(ranges)
        distances = np.empty(len(candidates))
        results = self._geometry_data.distanceResults
        for place, pair in enumerate(candidates.tolist()):
            pin.computeDistance(self._geometry, self._geometry_data, pair)
            distances[place] = results[pair].min_distance
        self._let_sleep(candidates, distances, ranges)
        chosen = np.flatnonzero(distances < ranges[candidates])
        chosen = chosen[np.argsort((distances - ranges[candidates])[chosen], kind="stable")][: self._most]
        pairs, distances = candidates[chosen], distances[chosen]
        rows = self._rows(pairs, [results[pair] for pair in pairs.tolist()])
        own = rows[:, self._own_joints].copy()
        rows[:, self._own_joints] = 0.0
        return Near(pairs, distances, own, rows)

    def _add(self, body: Any) -> int:
        low, high = local_box(body)
        centre, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        placed = body.placement * pin.SE3(np.eye(3), centre)
        self._spheres.addGeometryObject(
            pin.GeometryObject(body.name, body.parentJoint, placed, coal.Sphere(radius))
        )
        self._radii.append(radius)
        return int(self._geometry.addGeometryObject(body))

    def _split_spheres(self) -> None:
        """Spheres that stand still need no placing: keep only the moving ones where they are placed."""
        moving = pin.GeometryModel()
        self._centres = np.zeros((len(self._radii), 3))
        self._moving: list[int] = []
        for index, sphere in enumerate(self._spheres.geometryObjects):
            if sphere.parentJoint == WORLD:
                self._centres[index] = sphere.placement.translation
            else:
                moving.addGeometryObject(sphere)
                self._moving.append(index)
        self._spheres, self._sphere_data = moving, moving.createData()

    def _candidates(self, ranges: Array) -> Index:
        """Pairs that are due and that their bounding spheres do not keep apart."""
        pin.updateGeometryPlacements(self._model, self._data, self._spheres, self._sphere_data)
        self._centres[self._moving] = [placed.translation for placed in self._sphere_data.oMg]
        due = np.flatnonzero(self._due <= self._cycle)
        apart = self._centres[self._one[due]] - self._centres[self._other[due]]
        gaps = np.sqrt((apart * apart).sum(axis=1)) - self._reach[due]
        far = gaps > ranges[due]
        self._let_sleep(due[far], gaps[far], ranges)
        near: Index = due[~far]
        return near

    def _let_sleep(self, pairs: Index, distances: Array, ranges: Array) -> None:
        if self._step_m > 0.0:
            cycles = np.maximum((distances - ranges[pairs]) / self._step_m, 1.0).astype(np.intp)
            self._due[pairs] = self._cycle + cycles

    def _rows(self, pairs: Index, results: list[Any]) -> Array:
        """(k, m) change of each distance per increment of each joint."""
        if not results:
            return np.zeros((0, self._model.nv))
        # coal's normal points from the first body to the second; a force at a point is a wrench at the origin
        own, theirs = np.empty((len(results), 6)), np.empty((len(results), 6))
        for row, result in enumerate(results):
            x, y, z = (-result.normal).tolist()
            own[row] = _wrench(x, y, z, *result.getNearestPoint1().tolist())
            theirs[row] = _wrench(x, y, z, *result.getNearestPoint2().tolist())
        first, second = self._bodies[pairs].T
        twists = self._data.J
        rows: Array = (own @ twists) * self._moves[first] - (theirs @ twists) * self._moves[second]
        return rows

    def _moves_of(self, carriers: list[int]) -> Array:
        """(bodies, m) 1 where a joint moves a body."""
        moves = np.zeros((len(carriers), self._model.nv))
        for row, carrier in enumerate(carriers):
            for joint in self._model.supports[carrier]:
                if joint != WORLD:
                    moves[row, joint - 1] = 1.0
        return moves


def _wrench(x: float, y: float, z: float, px: float, py: float, pz: float) -> tuple[float, ...]:
    """A force (x, y, z) at a point (px, py, pz), with its moment about the origin."""
    return x, y, z, py * z - pz * y, pz * x - px * z, px * y - py * x
