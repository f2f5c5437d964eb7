"""Clearance by the exact shapes that the gate uses, for options that are shown or driven to."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.composite_model import composite_model
from deltaq_cell.group import Group
from deltaq_cell.proximity import ProximityEngine
from deltaq_controllers.criteria.near_bodies import Clearance
from deltaq_controllers.criteria.screen import Screen, least_gaps
from deltaq_controllers.kinematics import placement_views
from deltaq_protocol.arrays import Array, Flags


class ExactClearance:
    """Measures one robot of a cell, the others standing still.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        others: (n,) configuration of each other robot; at home if not given.
    """

    def __init__(self, cell: CellModel, robot: str, others: Mapping[str, Array] | None = None) -> None:
        self._proximity = ProximityEngine(cell)
        self._robot = robot
        lists = [self._proximity.alone[robot]]
        lists += [self._proximity.between[robot, name] for name in cell.robots if name != robot]
        self._lists = [groups for groups in lists if groups]
        self._kept = _KeptDistances(cell, robot, [group for groups in self._lists for group in groups])
        self.place({name: model.home for name, model in cell.robots.items()} | dict(others or {}))

    def place(self, others: Mapping[str, Array]) -> None:
        """Place other robots, each at its configuration (n,)."""
        for name, q in others.items():
            if name != self._robot:
                self._proximity.place(name, q, np.zeros(len(q)))
                self._kept.place(name, q)

    def keeps(self, q: Array, room_m: float = 0.0) -> bool:
        """Whether all configurations (N, n) have more than `room_m` beyond the stop distances; stops at the first."""
        return self._kept.at(q, room_m)

    def kept(self, q: Array, room_m: float = 0.0) -> Flags:
        """(N,) whether each of the configurations (N, n) has more than `room_m` beyond the stop distances."""
        return np.array([self._kept.at(one[None], room_m) for one in q], dtype=np.bool_)

    def measure(self, q: Array) -> Clearance:
        """The tightest pair at configuration `q` (n,)."""
        self._proximity.place(self._robot, q, np.zeros(len(q)))
        looks = [self._proximity.look(groups, 0.0) for groups in self._lists]
        rooms = [(near.swept_m - look.stop_distance_m, near) for look in looks if (near := look.tightest)]
        room_m, near = min(rooms, key=lambda item: item[0])
        return Clearance(room_m, near.distance_m, near.pair)


class _KeptDistances:
    """Whether the pairs of some groups keep their distances: much quicker than to measure them."""

    def __init__(self, cell: CellModel, robot: str, groups: Sequence[Group]) -> None:
        self._model, places = composite_model(cell)
        self._data, self._q = self._model.createData(), pin.neutral(self._model)
        self._slices = {
            name: slice(place.first_q, place.first_q + cell.robots[name].n) for name, place in places.items()
        }
        self._robot = robot
        self._geometry, numbers = pin.GeometryModel(), {}
        for group in groups:
            for pair in group.pairs:
                for body in pair:
                    if body.name not in numbers:
                        own = pin.GeometryObject(
                            body.name, body.parentJoint, body.placement, body.geometry.clone()
                        )
                        own.geometry.setSweptSphereRadius(0.0)
                        numbers[body.name] = self._geometry.addGeometryObject(own)
                self._geometry.addCollisionPair(pin.CollisionPair(*(numbers[body.name] for body in pair)))
        self._placed = self._geometry.createData()
        pairs = [(int(pair.first), int(pair.second)) for pair in self._geometry.collisionPairs]
        self._screen = Screen.of(list(self._geometry.geometryObjects), pairs)
        self._placements = placement_views(self._data)
        self._stop_m = np.array([group.stop_distance_m for group in groups for _ in group.pairs])
        self._room_m = np.nan
        with warnings.catch_warnings():
            # as `deltaq_cell.group.make_reproducible` says
            warnings.simplefilter("ignore", DeprecationWarning)
            for request in self._placed.collisionRequests:
                request.gjk_initial_guess = coal.GJKInitialGuess.DefaultGuess
                request.enable_cached_gjk_guess = False

    def place(self, robot: str, q: Array) -> None:
        """Place a robot at its configuration (n,)."""
        self._q[self._slices[robot]] = q

    def at(self, q: Array, room_m: float) -> bool:
        """Whether all configurations (N, n) keep more than `room_m` beyond the stop distances."""
        if room_m != self._room_m:
            for request, stop_m in zip(self._placed.collisionRequests, self._stop_m.tolist(), strict=True):
                request.security_margin = stop_m + room_m
            self._room_m = room_m
        return all(map(self._keeps, q))

    def _keeps(self, q: Array) -> bool:
        self.place(self._robot, q)
        pin.forwardKinematics(self._model, self._data, self._q)
        gaps = least_gaps(self._screen, np.concatenate(self._placements), self._stop_m + self._room_m)
        pairs = np.flatnonzero(np.isfinite(gaps)).tolist()
        if not pairs:
            return True
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed)
        return not any(pin.computeCollision(self._geometry, self._placed, pair) for pair in pairs)
