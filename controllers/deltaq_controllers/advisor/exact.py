"""Clearance by the exact shapes that the gate uses, for options that are shown or driven to."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.bodies import composite_model
from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import Group
from deltaq_cell.proximity import ProximityEngine
from deltaq_cell.robot import RobotModel
from deltaq_controllers.criteria.near_bodies import Clearance, Screen, least_gaps
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.kinematics import placement_views
from deltaq_controllers.task import NO_TASK, Task
from deltaq_protocol.arrays import Array, Flags, Indices

MEASURED = 12
"""Configurations of a path at which its least distance is measured."""


class ExactClearance:
    """Measures one robot of a cell, the others standing still; tolerances in configurations do not count.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        others: (n,) configuration of each other robot; at home if not given.
        left_out: pairs of names of bodies that may touch.
    """

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        others: Mapping[str, Array] | None = None,
        left_out: Iterable[tuple[str, str]] = (),
    ) -> None:
        self._proximity = ProximityEngine(cell)
        self._proximity.leave_out(left_out)
        self._robot, self._n = robot, cell.robots[robot].n
        self._groups = list(self._proximity.alone[robot])
        for name in cell.robots:
            if name != robot:
                self._groups += self._proximity.between[robot, name]
        self._groups = [group for group in self._groups if not group.is_empty]
        self._kept = _KeptDistances(cell, robot, self._groups)
        self.place({name: model.home for name, model in cell.robots.items()} | dict(others or {}))

    def place(self, others: Mapping[str, Array]) -> None:
        """Place other robots, each at its configuration (n,)."""
        for name, q in others.items():
            if name != self._robot:
                self._proximity.place(name, q, np.zeros(len(q)))
                self._kept.place(name, q)

    def keeps(self, q: Array, room_m: float = 0.0) -> bool:
        """Whether all configurations (N, n) have more than `room_m` beyond the stop distances; stops at the first."""
        return self._kept.at(q[:, : self._n], room_m)

    def kept(self, q: Array, room_m: float = 0.0) -> Flags:
        """(N,) whether each of the configurations (N, n) has more than `room_m` beyond the stop distances."""
        return np.array([self._kept.at(one[None, : self._n], room_m) for one in q], dtype=np.bool_)

    def measure(self, q: Array) -> Clearance:
        """The tightest pair at configuration `q` (n,)."""
        self._proximity.place(self._robot, q[: self._n], np.zeros(self._n))
        tightest = min(self._groups, key=lambda group: self._proximity.least(group) - group.stop_distance_m)
        near = tightest.nearest()
        return Clearance(near.swept_m - tightest.stop_distance_m, near.distance_m, near.pair)

    def tightest(self, path: Array) -> Clearance:
        """The tightest pair on a path (P, n), measured at `MEASURED` of its configurations."""
        places = np.linspace(0, len(path) - 1, MEASURED).round().astype(int)
        return min(map(self.measure, path[places]), key=lambda clearance: clearance.room_m)


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
            for pair in itertools.compress(group.pairs, group.active):
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
        self._stop_m = np.array(
            [group.stop_distance_m for group in groups for _ in range(group.active.sum())]
        )
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


# The spaces in which paths are searched for: with the hands fixed, or with all joints free.


class Space(Protocol):
    """Configurations that follow from some of their joints.

    Attributes:
        free: (m,) indices of the joints that the others follow from.
    """

    free: NDArray[np.intp]

    def walk(self, origin: Array, target: Array, pieces: int) -> Array:
        """(N, pieces + 1, n) paths from configurations (N, n), straight to (N, m); NaN past the reachable part."""
        ...

    def placed(self, free: Array, near: Array) -> Array:
        """(N, n) configurations with the free joints (N, m), each on the branch that (N, n) are on; NaN for none."""
        ...

    def barred(self, start: Array, goal: Array) -> str:
        """Why no path can lead from one configuration (n,) to another; empty if one may."""
        ...


class HandsKept:
    """Self-motions: the base joints move freely, and the arms keep the hands in place.

    Args:
        tracker: of the robot.
        T_world_hands: (h, 4, 4) where the hands are kept.
    """

    def __init__(self, tracker: ConstraintTracker, T_world_hands: Array) -> None:
        self._tracker, self._poses = tracker, T_world_hands
        self.free = tracker.base

    def walk(self, origin: Array, target: Array, pieces: int) -> Array:
        """Straight in the base, the arms following on their branches."""
        return self._tracker.walk(origin, target, self._poses, pieces)

    def placed(self, free: Array, near: Array) -> Array:
        """The arms on the branches nearest to `near`."""
        return self._tracker.track(free, self._poses, near)

    def barred(self, start: Array, goal: Array) -> str:
        """An arm that is on another branch at the goal: between branches lie singularities."""
        branches = zip(
            self._tracker.arms,
            self._tracker.branch(start, self._poses),
            self._tracker.branch(goal, self._poses),
            strict=True,
        )
        hands = [arm.hand for arm, here, there in branches if here != there]
        if not hands:
            return ""
        names = " and ".join(hands)
        arms, are = ("arms", "are") if len(hands) > 1 else ("arm", "is")
        return f"the {arms} of {names} {are} on another branch, beyond a singularity"


class HandsMoved:
    """All joints free, the hands wherever that takes them within the regions of a task."""

    def __init__(self, robot: RobotModel, task: Task = NO_TASK) -> None:
        self.free = np.arange(robot.n)
        self._regions = [(hand, region) for hand in robot.hands if (region := task.region(hand)) is not None]
        self._robot = robot

    def walk(self, origin: Array, target: Array, pieces: int) -> Array:
        """Straight in the joints."""
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        way: Array = origin[:, None] + shares * (target - origin)[:, None]
        for hand, region in self._regions:
            flat = way[:, 1:].reshape(-1, way.shape[2])
            places = np.array([self._robot.forward(q, hand)[:3, 3] for q in flat])
            way[:, 1:][~region.holds(places).reshape(way.shape[0], -1)] = np.nan
        return way

    def placed(self, free: Array, _near: Array) -> Array:
        """The joints as given."""
        return free

    def barred(self, _start: Array, _goal: Array) -> str:
        """No reason: every configuration may be connected."""
        return ""


# Where a path may pass (motion validity): clear of obstacles and limits, and without a jump of any joint.


STEP = 0.05
"""Distance in the free joints between two configurations that are checked while searching [rad or m]."""
FINE = 0.01
"""Distance in the free joints between two configurations of a returned path [rad or m]."""
FINER = (1, 4, 16)
"""Into so many times the pieces a straight path is divided until no joint jumps: an arm is quick near a singularity."""
LEAP = 4.0
"""Any joint may change by this many times the step; more is another branch, or too near to a singularity."""
SEARCHED_LEAP = 3.0
"""The same while searching, so that the finer check agrees."""
MARGIN_M = 0.015
"""Margin to bodies that the search keeps where start and goal have it, so that the finer check agrees."""
LIMIT_MARGIN = 0.05
"""Margin to joint limits that a path keeps where start and goal have it, so that it can be braked [rad or m]."""
LIMIT_SHARE = 0.02
"""The same as a fraction of the joint's range; the greater of the two counts."""
FINE_SHARE = 0.4
"""Fraction of the margins that is kept between the configurations that the search looked at."""
SAMPLED = 6
"""Of so many configurations of a path one is looked at first: most blocked paths are blocked over a good part."""


def limit_margin(robot: RobotModel) -> Array:
    """(n,) margin to the limits of the joints [rad or m]; of a narrow tolerance a tenth of its range."""
    extent = robot.upper - robot.lower
    margin: Array = np.minimum(np.maximum(LIMIT_MARGIN, LIMIT_SHARE * extent), 0.1 * extent)
    return margin


class MotionValidator:
    """Where paths between some configurations may pass.

    Args:
        robot: the robot, whose limits are kept.
        space: the space of the paths.
        exact: measures the distances of bodies.
        ends: (k, n) configurations that paths begin and end at; margins are no larger than these have them.
        wider: factor of the usual margin to bodies.

    Attributes:
        space: as given.
        margin_m: margin to bodies that is kept.
    """

    def __init__(
        self, robot: RobotModel, space: Space, exact: ExactClearance, ends: Array, wider: float
    ) -> None:
        self.space, self._exact = space, exact
        room_m = min(exact.measure(q).room_m for q in ends)
        self.margin_m = float(np.clip(0.8 * room_m, 0.0, wider * MARGIN_M))
        self._limits = robot.lower, robot.upper
        self._margin = limit_margin(robot)
        self._lowest, self._highest = ends.min(axis=0), ends.max(axis=0)

    def within(self, q: Array, share: float = 1.0) -> Flags:
        """(...) whether configurations (..., n) keep a fraction of the margin to the limits."""
        lower, upper = self._limits
        low = np.minimum(lower + share * self._margin, self._lowest)
        high = np.maximum(upper - share * self._margin, self._highest)
        within: Flags = np.all((q >= low) & (q <= high), axis=-1)
        return within

    def clear(self, q: Array) -> Flags:
        """(N,) whether configurations (N, n) keep the margins to bodies and limits."""
        clear = self.within(q)
        inside = np.flatnonzero(clear)
        if len(inside):
            clear[inside] = self._exact.kept(q[inside], self.margin_m)
        return clear

    def walk(self, origin: Array, target: Array) -> tuple[Array, Indices]:
        """Paths that are straight in the free joints.

        Args:
            origin: (N, n) where they begin.
            target: (N, m) free joints where they end.

        Returns:
            (N, P + 1, n) configurations, and (N,) the last one up to which each path is inside the limits and
            without a jump.
        """
        change = float(np.abs(target - origin[:, self.space.free]).max(initial=0.0))
        way = self.space.walk(origin, target, max(1, int(np.ceil(change / STEP))))
        steady = np.abs(np.diff(way, axis=1)).max(axis=2) <= SEARCHED_LEAP * STEP
        last: Indices = np.logical_and.accumulate(steady & self.within(way[:, 1:]), axis=1).sum(axis=1)
        return way, last

    def straight(self, origin: Array, target: Array) -> Flags:
        """(N,) whether configurations (N, n) can be reached from others (N, n) straight in the free joints."""
        way, last = self.walk(origin, target[:, self.space.free])
        passes: Flags = (last == way.shape[1] - 1) & (np.abs(way[:, -1] - target).max(axis=1) < 1e-6)
        between = np.arange(1, way.shape[1])
        for looked_at in (between[between % SAMPLED == 0], between[between % SAMPLED != 0]):
            rows = np.flatnonzero(passes)
            if len(rows) and len(looked_at):
                seen = self.clear(way[rows][:, looked_at].reshape(-1, way.shape[2]))
                passes[rows] = seen.reshape(len(rows), -1).all(axis=1)
        return passes

    def fine(self, corners: Array) -> Array | None:
        """(P, n) the path from corner to corner (k, n) as it is returned; None if a joint jumps."""
        legs = [corners[:1]]
        for start, corner in zip(corners[:-1], corners[1:, self.space.free], strict=True):
            change = np.abs(corner - start[self.space.free]).max()
            pieces = max(1, int(np.ceil(change / FINE)))
            for finer in FINER:
                (leg,) = self.space.walk(start[None], corner[None], finer * pieces)
                if self.is_steady(leg):
                    break
            legs.append(leg[1:])
        path = np.concatenate(legs)
        return path if self.is_steady(path) and np.abs(path[-1] - corners[-1]).max() < 1e-6 else None

    def is_steady(self, path: Array) -> bool:
        """Whether no joint jumps along a path (P, n) that is to be returned."""
        return bool((np.abs(np.diff(path, axis=0)).max(axis=1) <= LEAP * FINE).all())
