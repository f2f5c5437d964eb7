"""The bodies near a robot, their distances, and the derivatives of these by all joints of the cell.

All robots of the cell are one pinocchio model, so that the rate of a distance is one row over all joints: with n
the unit vector from the other body's nearest point b to the own body's nearest point a,

    d' = n . (J_a(a) - J_b(b)) q'

where q' holds the rates of every robot. A pair is measured only if it can be among the nearest: not while its bodies
have travelled too little for that since they were last measured, nor while their bounding spheres are farther apart.
A body travels no farther than its sphere's centre, plus the sphere's radius times all rotations that turned it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import WORLD, composite_model
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled import compiled
from deltaq_cell.group import make_reproducible
from deltaq_controllers.kinematics import JointTree, joint_tree, placed_joints
from deltaq_controllers.spheres import Spheres, local_box, placed
from deltaq_controllers.vectors import cross, distance
from deltaq_protocol.arrays import Array, Indices

# Pairs of bodies, compiled: which can be near, which are the nearest, how joints change their distance.

_LEAST_RANGE_M = 1e-3
"""Of smaller ranges, or none, no fraction is taken [m]."""

TOUCHING_M = 1e-3
"""Nearest points that are closer give no direction [m]."""


@compiled
def go_to(
    tree: JointTree,
    q: Array,
    spheres: Spheres,
    moving: Indices,
    turned_by: Array,
    q_before: Array,
    centres: Array,
    travel: Array,
) -> Array:
    """Move the `centres` of the `moving` bodies, and add to their `travel` how far they can have gone [m].

    Each travels no farther than its centre, plus its radius times the rotations of all joints that it is `turned_by`.

    Returns:
        (6, m) unit twists of the joints, at the world's origin.
    """
    placements, columns = placed_joints(tree, q)
    now, turned = placed(spheres, placements), np.abs(q - q_before)
    for i in range(len(moving)):
        body = moving[i]
        travel[body] += distance(now[i], centres[body]) + spheres.radii[i] * (turned_by[i] * turned).sum()
        centres[body] = now[i]
    return columns


@compiled
def note_distances(
    pairs: Indices, distances: Array, one: Indices, other: Indices, travel: Array, at_least: Array
) -> None:
    """Store measured distances (k,) of pairs, so that later travel gives lower bounds of them."""
    for k in range(len(pairs)):
        pair = pairs[k]
        at_least[pair] = distances[k] + travel[one[pair]] + travel[other[pair]]


@compiled
def candidates(
    one: Indices,
    other: Indices,
    reported: Indices,
    distances: Array,
    most: int,
    ranges_m: Array,
    travel: Array,
    centres: Array,
    radii: Array,
    at_least: Array,
) -> Indices:
    """Pairs except those of last time that can be among the nearest; bounds from their spheres go to `at_least`.

    Those of last time, at `distances` (k,) now, bound how near a pair has to be to be among the `most` nearest.
    """
    ranges = _ranges_of_nearer(ranges_m, reported, distances, most)
    possible = at_least - travel[one] - travel[other] < ranges
    possible[reported] = False
    near = np.zeros(len(ranges), dtype=np.bool_)
    for pair in np.flatnonzero(possible):
        i, j = one[pair], other[pair]
        gap = distance(centres[i], centres[j]) - radii[i] - radii[j]
        at_least[pair] = max(at_least[pair], gap + travel[i] + travel[j])
        near[pair] = gap < ranges[pair]
    return np.flatnonzero(near)


@compiled
def _ranges_of_nearer(ranges: Array, reported: Indices, distances: Array, most: int) -> Array:
    """(p,) how near a pair has to be to be among the `most` nearest, given the distances (k,) of those found so far."""
    share = 1.0
    if len(reported) == most:
        farthest = 0.0
        for i in range(most):
            farthest = max(farthest, distances[i] / max(ranges[reported[i]], _LEAST_RANGE_M))
        share = min(farthest, 1.0)
    return np.where(ranges > 0.0, share * ranges, ranges)


@compiled
def nearest(ranges: Array, pairs: Indices, distances: Array, most: int) -> Indices:
    """Indices of at most `most` of the `pairs` (k,) in range, the least fraction of their range first."""
    # of two equal pairs the one that is first in the list of all pairs comes first
    order = np.argsort(pairs, kind="mergesort")
    shares = distances / np.maximum(ranges[pairs], _LEAST_RANGE_M)
    nearest = order[np.argsort(shares[order], kind="mergesort")][:most]
    return nearest[distances[nearest] < ranges[pairs[nearest]]]


@compiled
def rows_of(
    pairs: Indices,
    points: Array,
    normals: Array,
    distances: Array,
    columns: Array,
    one: Indices,
    other: Indices,
    moves: Array,
    begin: int,
    end: int,
) -> tuple[Array, Array]:
    """Change of distances by the own joints, (k, n), and by all others, (k, m).

    Args:
        pairs: (k,) the pairs.
        points: (k, 2, 3) nearest points of each [m].
        normals: (k, 3) where it touches coal's normal, first to second body.
        distances: (k,) of these points [m].
        columns: (6, m) unit twists of the joints, at the world's origin.
        one: (p,) the first body of each pair.
        other: (p,) the second.
        moves: (bodies, m) 1 where a joint moves a body.
        begin: the first of the own joints.
        end: the joint after the last of them.
    """
    rows = np.zeros((len(pairs), columns.shape[1]))
    for k in range(len(pairs)):
        first, second = moves[one[pairs[k]]], moves[other[pairs[k]]]
        point1, point2 = points[k, 0], points[k, 1]
        away = -normals[k] if distances[k] < TOUCHING_M else (point1 - point2) / distances[k]
        # a force at a point is a wrench at the origin
        moment1, moment2 = cross(point1, away), cross(point2, away)
        for joint in range(columns.shape[1]):
            alike = first[joint] - second[joint]
            for axis in range(3):
                moment = first[joint] * moment1[axis] - second[joint] * moment2[axis]
                rows[k, joint] += (
                    alike * away[axis] * columns[axis, joint] + moment * columns[3 + axis, joint]
                )
    own = rows[:, begin:end].copy()
    rows[:, begin:end] = 0.0
    return own, rows


_UNKNOWN_M = -1e6
"""Lower bound of the distance of a pair that was never measured [m]."""


class NearPairs(NamedTuple):
    """Pairs of bodies in range, those first whose distance is the least fraction of it.

    Attributes:
        pairs: (k,) index of each in `Neighbours.names`.
        distance: (k,) their distance, negative where they overlap [m].
        own: (k, n) change of the distance per increment of the own joints.
        others: (k, m) change per increment of the joints of all robots of the cell, the own ones zero.
    """

    pairs: Indices
    distance: Array
    own: Array
    others: Array


class Neighbours:
    """Measures distances of a robot's bodies to all other bodies and to one another.

    Args:
        cell: the cell.
        robot: name of the robot.
        most: how many pairs are returned.

    Attributes:
        names: pair of body names by index.
        foreign: (p,) whether the pair's other body belongs to another robot.
        same: (p,) whether both bodies belong to the robot.
    """

    def __init__(self, cell: CellModel, robot: str, most: int = 10) -> None:
        self._model, places = composite_model(cell)
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
        self._tree = joint_tree(self._model)
        self._surround(carriers)
        revolute = np.concatenate([model.revolute for model in cell.robots.values()])
        self._turned_by = self._moves[self._moving] * revolute
        self._q = np.zeros(self._model.nq)
        self._travel = np.zeros(len(carriers))
        self._at_least = np.where(checked, _UNKNOWN_M, np.inf)
        self._reported: Indices = np.zeros(0, dtype=np.intp)

    def near(self, q: Array, ranges: Array) -> NearPairs:
        """The nearest pairs at a configuration, ordered by distance over range.

        Ordered by distance less range, the many bodies of an approaching robot, which matter from afar, would
        displace the floor.

        Args:
            q: (m,) joints of all robots of the cell, in its order [rad or m].
            ranges: (p,) distance of each pair below which it matters [m].
        """
        self._place(q)
        reported = self._reported
        distances = self._measure(reported)
        others = self._candidates(ranges, distances)
        pairs = reported
        if len(others):
            pairs = np.concatenate([reported, others])
            distances = np.concatenate([distances, self._measure(others)])
        chosen = nearest(ranges, pairs, distances, self._most)
        self._reported, distances = pairs[chosen], distances[chosen]
        own, rows = self._rows(self._reported, distances)
        return NearPairs(self._reported, distances, own, rows)

    def _surround(self, carriers: Indices) -> None:
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

    def _place(self, q: Array) -> None:
        """Place the robots, and note how far their bodies can have travelled."""
        pin.forwardKinematics(self._model, self._data, q)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data)
        self._columns = go_to(
            self._tree,
            q,
            self._spheres,
            self._moving,
            self._turned_by,
            self._q,
            self._centres,
            self._travel,
        )
        self._q = q

    def _candidates(self, ranges: Array, distances: Array) -> Indices:
        """Pairs other than those returned last time, at distances (k,) now, that can be among the nearest."""
        return candidates(
            self._one,
            self._other,
            self._reported,
            distances,
            self._most,
            ranges,
            self._travel,
            self._centres,
            self._radii,
            self._at_least,
        )

    def _measure(self, pairs: Indices) -> Array:
        """(k,) distances of pairs [m]."""
        distances = np.empty(len(pairs))
        for place, pair in enumerate(pairs.tolist()):
            pin.computeDistance(self._geometry, self._geometry_data, pair)
            distances[place] = self._results[pair].min_distance
        note_distances(pairs, distances, self._one, self._other, self._travel, self._at_least)
        return distances

    def _rows(self, pairs: Indices, distances: Array) -> tuple[Array, Array]:
        """Change of each distance, as it was measured, per increment of the own joints (k, n) and of others (k, m)."""
        results = [self._results[pair] for pair in pairs.tolist()]
        normals = np.zeros((len(pairs), 3))
        for place, distance_m in enumerate(distances.tolist()):
            if distance_m < TOUCHING_M:
                normals[place] = results[place].normal
        return rows_of(
            pairs,
            _points(results),
            normals,
            distances,
            self._columns,
            self._one,
            self._other,
            self._moves,
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


def _points(results: Sequence[Any]) -> Array:
    """(k, 2, 3) nearest points, as coal has measured them [m]."""
    if not results:
        return np.empty((0, 2, 3))
    points = [point for one in results for point in (one.getNearestPoint1(), one.getNearestPoint2())]
    return np.concatenate(points).reshape(-1, 2, 3)
