"""Which bodies of a cell are near a robot, how near, and how its joints and the others' change that.

All robots of the cell are one pinocchio model, so that the rate of a distance is one row over all joints: with n
the unit vector from the other body's nearest point b to the own body's nearest point a,

    d' = n . (J_a(a) - J_b(b)) q'

where q' holds the rates of every robot. A pair is measured only if it can be among the nearest: not while its bodies
have travelled less than would bring them so near since they were last measured, nor while their bounding spheres
are farther apart. A body travels no farther than its sphere's centre, and the sphere's radius times all that turned it.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import make_reproducible
from deltaq_cell.joined import WORLD, joined
from deltaq_controllers.compiled import compiled
from deltaq_controllers.kinematics import placement_views
from deltaq_controllers.spheres import Spheres, local_box, placed
from deltaq_controllers.vectors import cross, distance

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_UNKNOWN_M = -1e6
"""What is known of the distance of a pair that was never measured [m]."""

_LEAST_RANGE_M = 1e-3
"""Of smaller ranges, or none, there is no share [m]."""

_TOUCHING_M = 1e-3
"""Nearest points that are closer tell no direction [m]."""


class Near(NamedTuple):
    """Pairs of bodies in range, those first whose distance is the least share of it.

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
        most: how many pairs are told.

    Attributes:
        names: pair of body names by index.
        foreign: (p,) whether the pair's other body belongs to another robot.
        same: (p,) whether both bodies belong to the robot.
    """

    def __init__(self, cell: CellModel, robot: str, most: int = 10) -> None:
        self._model, places = joined(cell)
        self._data = self._model.createData()
        self._most = most
        first, n = places[robot].first_q, cell.robots[robot].n
        self._own_joints = slice(first, first + n)
        self._geometry = pin.GeometryModel()
        own: list[int] = []
        foreign: list[int] = []
        standing: list[int] = []
        for name, model in cell.robots.items():
            for body in model.geometry.geometryObjects:
                index = self._geometry.addGeometryObject(places[name].moved(body))
                (standing if body.parentJoint == WORLD else own if name == robot else foreign).append(index)
        for body in cell.structure:
            standing.append(self._geometry.addGeometryObject(body))
        never = {frozenset(pair) for model in cell.robots.values() for pair in model.never_checked_pairs()}
        pairs = [(i, j) for i in own for j in (*foreign, *standing)]
        pairs += list(combinations(own, 2))
        names = [body.name for body in self._geometry.geometryObjects]
        checked = np.array([frozenset((names[i], names[j])) not in never for i, j in pairs])
        self.names = tuple((names[i], names[j]) for i, j in pairs)
        self._one, self._other = np.array(pairs, dtype=np.intp).reshape(-1, 2).T.copy()
        self.foreign = np.isin(self._other, foreign)
        self.same = np.isin(self._other, own)
        for i, j in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._geometry_data = self._geometry.createData()
        make_reproducible(self._geometry_data)
        self._results = list(self._geometry_data.distanceResults)
        carriers = np.array([body.parentJoint for body in self._geometry.geometryObjects])
        self._moves = self._moves_of(carriers.tolist())
        self._columns: Array = self._data.J
        self._surround(carriers)
        revolute = np.concatenate([model.revolute for model in cell.robots.values()])
        self._turned_by = self._moves[self._moving] * revolute
        self._q = np.zeros(self._model.nq)
        self._travel = np.zeros(len(carriers))
        self._at_least = np.where(checked, _UNKNOWN_M, np.inf)
        self._told: Index = np.zeros(0, dtype=np.intp)

    def near(self, q: Array, ranges: Array) -> Near:
        """What is near at a configuration, as a share of the range.

        By distance less range the many bodies of a robot that comes, which matter from afar, would crowd out the floor.

        Args:
            q: (m,) joints of all robots of the cell, in its order [rad or m].
            ranges: (p,) distance of each pair from which on it matters [m].
        """
        self._place(q)
        told = self._told
        distances = self._measure(told)
        # those told last time tell how near a pair has to be to be told now
        others = self._candidates(_nearer(ranges, told, distances, self._most))
        pairs, distances = np.concatenate([told, others]), np.concatenate([distances, self._measure(others)])
        chosen = _nearest(ranges, pairs, distances, self._most)
        self._told, distances = pairs[chosen], distances[chosen]
        own, rows = self._rows(self._told, distances)
        return Near(self._told, distances, own, rows)

    def _surround(self, carriers: Index) -> None:
        """Bounding spheres of the bodies; `_centres` and `_radii` of all, `_spheres` to place the `_moving` ones."""
        centres, radii = [], []
        for body in self._geometry.geometryObjects:
            low, high = local_box(body)
            centres.append(body.placement.act(0.5 * (low + high)))
            radii.append(0.5 * float(np.linalg.norm(high - low)))
        self._centres, self._radii = np.array(centres), np.array(radii)
        self._moving = np.flatnonzero(carriers != WORLD)
        self._spheres = Spheres(
            carriers[self._moving], self._centres[self._moving], self._radii[self._moving]
        )
        self._placements = placement_views(self._data)

    def _place(self, q: Array) -> None:
        """Place the robots, and note how far their bodies can have travelled."""
        pin.computeJointJacobians(self._model, self._data, q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data)
        placements = np.concatenate(self._placements)
        turned = np.abs(q - self._q)
        _travel(self._spheres, placements, self._moving, self._turned_by, turned, self._centres, self._travel)
        self._q = q

    def _candidates(self, ranges: Array) -> Index:
        """Pairs other than those told that can be within (p,) ranges."""
        return _candidates(
            self._one,
            self._other,
            self._told,
            ranges,
            self._travel,
            self._centres,
            self._radii,
            self._at_least,
        )

    def _measure(self, pairs: Index) -> Array:
        """(k,) distances of pairs [m]."""
        distances = np.empty(len(pairs))
        for place, pair in enumerate(pairs.tolist()):
            pin.computeDistance(self._geometry, self._geometry_data, pair)
            distances[place] = self._results[pair].min_distance
        self._at_least[pairs] = distances + self._travel[self._one[pairs]] + self._travel[self._other[pairs]]
        return distances

    def _rows(self, pairs: Index, distances: Array) -> tuple[Array, Array]:
        """Change of each distance, as it was measured, per increment of the own joints (k, n) and of others (k, m)."""
        contacts = np.empty((len(pairs), 3, 3))
        for contact, pair, distance_m in zip(contacts, pairs.tolist(), distances.tolist(), strict=True):
            result = self._results[pair]
            contact[0], contact[1] = result.getNearestPoint1(), result.getNearestPoint2()
            if distance_m < _TOUCHING_M:
                contact[2] = result.normal
        return _rows(
            contacts,
            distances,
            self._columns,
            self._moves[self._one[pairs]],
            self._moves[self._other[pairs]],
            self._own_joints.start,
            self._own_joints.stop,
        )

    def _moves_of(self, carriers: list[int]) -> Array:
        """(bodies, m) 1 where a joint moves a body."""
        moves = np.zeros((len(carriers), self._model.nv))
        for row, carrier in enumerate(carriers):
            for joint in self._model.supports[carrier]:
                if joint != WORLD:
                    moves[row, joint - 1] = 1.0
        return moves


@compiled
def _travel(
    spheres: Spheres,
    placements: Array,
    moving: Index,
    turned_by: Array,
    turned: Array,
    centres: Array,
    travel: Array,
) -> None:
    """Move the `centres` of the `moving` bodies, and add to their `travel` how far they can have gone [m].

    Each goes no farther than its centre, and its radius times what all the joints turned that it is `turned_by`.
    """
    now = placed(spheres, placements)
    for i in range(len(moving)):
        body = moving[i]
        travel[body] += distance(now[i], centres[body]) + spheres.radii[i] * (turned_by[i] * turned).sum()
        centres[body] = now[i]


@compiled
def _candidates(
    one: Index,
    other: Index,
    told: Index,
    ranges: Array,
    travel: Array,
    centres: Array,
    radii: Array,
    at_least: Array,
) -> Index:
    """Pairs but those told that can be within (p,) ranges; what their spheres tell is noted in `at_least`."""
    possible = at_least - travel[one] - travel[other] < ranges
    possible[told] = False
    near = np.zeros(len(ranges), dtype=np.bool_)
    for pair in np.flatnonzero(possible):
        i, j = one[pair], other[pair]
        gap = distance(centres[i], centres[j]) - radii[i] - radii[j]
        at_least[pair] = max(at_least[pair], gap + travel[i] + travel[j])
        near[pair] = gap < ranges[pair]
    return np.flatnonzero(near)


@compiled
def _nearer(ranges: Array, told: Index, distances: Array, most: int) -> Array:
    """(p,) how near a pair has to be to be among the `most` told, given the distances (k,) of those told so far."""
    share = 1.0
    if len(told) == most:
        farthest = 0.0
        for i in range(most):
            farthest = max(farthest, distances[i] / max(ranges[told[i]], _LEAST_RANGE_M))
        share = min(farthest, 1.0)
    return np.where(ranges > 0.0, share * ranges, ranges)


@compiled
def _nearest(ranges: Array, pairs: Index, distances: Array, most: int) -> Index:
    """Places of those of `pairs` (k,) in range, the least share of their range first, and `most` of them at most."""
    # one of two alike comes first that does in the list of all pairs
    order = np.argsort(pairs, kind="mergesort")
    shares = distances / np.maximum(ranges[pairs], _LEAST_RANGE_M)
    nearest = order[np.argsort(shares[order], kind="mergesort")][:most]
    return nearest[distances[nearest] < ranges[pairs[nearest]]]


@compiled
def _rows(
    contacts: Array, distances: Array, columns: Array, first: Array, second: Array, begin: int, end: int
) -> tuple[Array, Array]:
    """Change of distances by the own joints, (k, n), and by all others, (k, m).

    Args:
        contacts: (k, 3, 3) nearest points of each pair and, where it touches, coal's normal, first to second body.
        distances: (k,) of these points [m].
        columns: (6, m) velocities of what the joints carry, at the world's origin.
        first: (k, m) 1 where a joint moves the first body.
        second: (k, m) 1 where a joint moves the second.
        begin: the first of the own joints.
        end: the joint after the last of them.
    """
    rows = np.zeros((len(contacts), columns.shape[1]))
    for k in range(len(contacts)):
        point1, point2 = contacts[k, 0], contacts[k, 1]
        away = -contacts[k, 2] if distances[k] < _TOUCHING_M else (point1 - point2) / distances[k]
        # a force at a point is a wrench at the origin
        moment1, moment2 = cross(point1, away), cross(point2, away)
        for joint in range(columns.shape[1]):
            alike = first[k, joint] - second[k, joint]
            for axis in range(3):
                moment = first[k, joint] * moment1[axis] - second[k, joint] * moment2[axis]
                rows[k, joint] += (
                    alike * away[axis] * columns[axis, joint] + moment * columns[3 + axis, joint]
                )
    own = rows[:, begin:end].copy()
    rows[:, begin:end] = 0.0
    return own, rows
