"""The bodies that a robot's own are near to, by the exact shapes that the gate uses, for criteria of clearance.

The pairs are of three kinds: the robot with itself, with the structure, and with other robots. A pair whose distance
the hands' poses fix, such as a gripper and the workpiece, is left out: no configuration changes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations

import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.composite_model import composite_model
from deltaq_cell.group import make_reproducible
from deltaq_controllers.criteria.screen import Screen, least_gaps
from deltaq_controllers.kinematics import placement_views
from deltaq_protocol.arrays import Array, Indices

SOFT_M = 0.02
"""Pairs count that are nearer than the nearest of their kind and a few times this [m]."""
WINDOW_M = 3.0 * SOFT_M
"""Those farther off have less than a fiftieth of its weight [m]."""
FAR_M = 0.25
"""Room beyond which nothing is gained [m]."""


class PairKind(IntEnum):
    """With what a robot's body is near."""

    SELF = 0
    ENVIRONMENT = 1
    ROBOTS = 2


@dataclass(frozen=True)
class Clearance:
    """Two bodies that are near.

    Attributes:
        room_m: distance beyond the stop distance.
        distance_m: distance.
        pair: names of the two bodies.
    """

    room_m: float
    distance_m: float
    pair: tuple[str, str]


@dataclass(frozen=True)
class MeasuredPairs:
    """The nearest pairs of each kind at each of N configurations, e in all.

    Attributes:
        row: (e,) of which configuration.
        kind: (e,) of which kind.
        room: (e,) distance beyond the stop distance [m].
        first: (e,) index of the joint that carries the first body.
        second: (e,) that of the second; -1 for one that stands still.
        on_first: (e, 3) nearest point of the first body, in the world [m].
        on_second: (e, 3) nearest point of the second [m].
        away: (e, 3) unit vector along which the first point gains room.
    """

    row: Indices
    kind: Indices
    room: Array
    first: Indices
    second: Indices
    on_first: Array
    on_second: Array
    away: Array


class NearBodies:
    """Measures one robot of a cell, the others standing still.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        others: (n,) configuration of each other robot that counts; without them no other robot counts.

    Attributes:
        names: names of the bodies of each pair.
        kinds: (p,) kind of each pair.
    """

    def __init__(self, cell: CellModel, robot: str, others: Mapping[str, Array] | None = None) -> None:
        gate, model = cell.description.gate, cell.robots[robot]
        self._model, places = composite_model(cell)
        self._data, self._q = self._model.createData(), pin.neutral(self._model)
        self._slices = {
            name: slice(place.first_q, place.first_q + cell.robots[name].n) for name, place in places.items()
        }
        self._robot, self._first = robot, places[robot].first_q
        self._geometry = pin.GeometryModel()
        own = [
            self._geometry.addGeometryObject(places[robot].moved(body))
            for body in model.geometry.geometryObjects
        ]
        standing = [self._geometry.addGeometryObject(body) for body in cell.structure]
        foreign = [
            self._geometry.addGeometryObject(places[name].moved(body))
            for name in (others or {})
            if name != robot
            for body in cell.robots[name].geometry.geometryObjects
        ]
        bodies = list(self._geometry.geometryObjects)
        self._joints = [
            int(body.parentJoint) - 1 - self._first if i in set(own) else -1 for i, body in enumerate(bodies)
        ]
        last = {int(model.model.frames[model.frame_of(hand)].parentJoint) - 1 for hand in model.hands}
        # a hand stays where it is, and what its last joint carries with it
        still = {i for i in range(len(bodies)) if self._joints[i] < 0 or self._joints[i] in last}
        never = {frozenset(pair) for pair in model.never_checked_pairs()}
        pairs: list[tuple[int, int]] = []
        kinds: list[PairKind] = []
        for kind, of_kind in (
            (PairKind.SELF, combinations(own, 2)),
            (PairKind.ENVIRONMENT, ((i, j) for i in own for j in standing)),
            (PairKind.ROBOTS, ((i, j) for i in own for j in foreign)),
        ):
            for i, j in of_kind:
                if self._joints[i] == self._joints[j] or {i, j} <= still:
                    continue
                if frozenset((bodies[i].name, bodies[j].name)) not in never:
                    pairs.append((i, j))
                    kinds.append(kind)
        self.names = [(bodies[i].name, bodies[j].name) for i, j in pairs]
        self.kinds = np.array(kinds, dtype=np.intp)
        self._carriers = [(self._joints[i], self._joints[j]) for i, j in pairs]
        self._stop_m = np.where(self.kinds == PairKind.SELF, gate.self_stop_distance_m, gate.stop_distance_m)
        self._stops = self._stop_m.tolist()
        for i, j in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._placed = self._geometry.createData()
        make_reproducible(self._placed)
        self._results = list(self._placed.distanceResults)
        self._screen = Screen.of(bodies, pairs)
        self._views = placement_views(self._data)
        self.place(others or {})
        self._measured(model.home)  # so that the first look that counts waits for no compiler

    def place(self, others: Mapping[str, Array]) -> None:
        """Place other robots, each at its configuration (n,)."""
        for name, q in others.items():
            if name != self._robot:
                self._q[self._slices[name]] = q

    def near(self, q: Array) -> MeasuredPairs:
        """The nearest pairs of each kind at configurations (N, n)."""
        found: list[tuple[int, int, float, Array]] = []
        for row, one in enumerate(q):
            for pair, room_m in self._measured(one):
                result = self._results[pair]
                # copies: the next configuration is measured in the same place
                points = np.array([result.getNearestPoint1(), result.getNearestPoint2(), result.normal])
                found.append((row, pair, room_m, points))
        if not found:
            none, index = np.empty((0, 3)), np.empty(0, dtype=np.intp)
            return MeasuredPairs(index, index, np.empty(0), index, index, none, none, none)
        rows, pairs, rooms, measured = zip(*found, strict=True)
        points = np.array(measured)
        joints = np.array([self._carriers[pair] for pair in pairs])
        return MeasuredPairs(
            row=np.array(rows),
            kind=self.kinds[list(pairs)],
            room=np.array(rooms),
            first=joints[:, 0],
            second=joints[:, 1],
            on_first=points[:, 0],
            on_second=points[:, 1],
            away=-points[:, 2],
        )

    def nearest(self, q: Array) -> dict[PairKind, Clearance]:
        """The nearest pair of each kind that is near at `q` (n,)."""
        nearest: dict[PairKind, Clearance] = {}
        for pair, room_m in self._measured(q):
            kind = PairKind(int(self.kinds[pair]))
            if kind not in nearest or room_m < nearest[kind].room_m:
                nearest[kind] = Clearance(room_m, room_m + self._stops[pair], self.names[pair])
        return nearest

    def _measured(self, q: Array) -> list[tuple[int, float]]:
        """Pairs that are near at `q` (n,), and their room [m]."""
        self._q[self._slices[self._robot]] = q
        pin.forwardKinematics(self._model, self._data, self._q)
        gaps = least_gaps(self._screen, np.concatenate(self._views), self._stop_m + FAR_M) - self._stop_m
        near = np.flatnonzero(np.isfinite(gaps))
        if not len(near):
            return []
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed)
        near = near[np.argsort(gaps[near], kind="stable")]
        of_near = zip(near.tolist(), gaps[near].tolist(), self.kinds[near].tolist(), strict=True)
        within = [FAR_M] * len(PairKind)
        measured: list[tuple[int, int, float]] = []
        for pair, gap, kind in of_near:
            if gap >= within[kind]:
                continue
            pin.computeDistance(self._geometry, self._placed, pair)
            room_m = self._results[pair].min_distance - self._stops[pair]
            if room_m < within[kind]:
                within[kind] = min(within[kind], room_m + WINDOW_M)
                measured.append((pair, kind, room_m))
        return [(pair, room_m) for pair, kind, room_m in measured if room_m <= within[kind]]
