"""All that the gate asks the kernel for one decision: a whole certificate, or the search for a share, in one call.

The kernel's arrays are handed over once for all tubes that a robot's is held against, instead of once for each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.group import Group, Nearest, PairedGroups, make_reproducible, pairs_alone
from deltaq_cell.kernel.arrays import Anatomy, Findings, Integers, Pairs, Placed
from deltaq_cell.kernel.course import Course, course_points, keeps_limits, lay_course
from deltaq_cell.kernel.decision import Against, Suspected, Told, certify_all, largest_share
from deltaq_cell.kernel.look import NONE
from deltaq_cell.kernel.pieces import Stack, Tube
from deltaq_protocol.arrays import Array

_ALONE = -1
"""In place of the number of another robot."""

OVERLAP_M = 1e-6
"""Bodies that are nearer may be in one another; the kernel does not tell how far."""

_APART_M = 1e-5
"""Rooms that the kernel bounds farther apart than this are in the same order when coal measures them, to 2e-6 m."""


class KernelArrays(NamedTuple):
    """Arguments of the kernel: arrays that are reused in every call."""

    anatomy: Anatomy
    where: Placed
    stack: Stack
    found: Findings


@dataclass(frozen=True)
class WholeCertificate:
    """Result of certifying a robot's whole tube.

    Attributes:
        holds: whether every pair keeps the requested distance anywhere in the tube.
        left: remaining budget [searches].
        tightest: the pair with the least room, of all first looks or of the failing one; None without pairs.
        stop_distance_m: of that pair [m].
        failing: the pairs that are not certified; empty if it holds.
        other: the robot on the other side there, None if there is none.
    """

    holds: bool
    left: int
    tightest: Nearest | None
    stop_distance_m: float
    failing: PairedGroups | None
    other: str | None


class Decisions:
    """Certificates of whole tubes, and searches for the largest share of a request.

    Args:
        arrays: the kernel's arrays.
        pairs: all pairs of the cell, one list after the other.
        ranges: per robot its first joint and one more than its last, then likewise for its bodies.
        alone: per robot the pairs of its links with standing bodies and with each other.
        between: per ordered pair of robots the pairs of the first one's links with the second's.
        meter: measures single pairs.
        forget: is called when the robots' placements are no longer valid.
    """

    def __init__(
        self,
        arrays: KernelArrays,
        pairs: Pairs,
        ranges: Mapping[str, tuple[tuple[int, int], tuple[int, int]]],
        alone: Mapping[str, PairedGroups],
        between: Mapping[tuple[str, str], PairedGroups],
        meter: Meter,
        forget: Callable[[], None],
    ) -> None:
        self._arrays, self._pairs, self._ranges = arrays, pairs, ranges
        self._alone, self._between = alone, between
        self._meter, self._forget = meter, forget
        self._number = {name: number for number, name in enumerate(ranges)}
        self._every = np.arange(len(pairs.first))
        self._least_stop_m = float(pairs.stop_m.min(initial=np.inf))
        joints = arrays.stack.told.shape[1]
        self._q, self._widest = np.zeros(joints), max((last - first for (first, last), _ in ranges.values()))
        self._told = _told(2, joints)
        self._suspected = Suspected(np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros(0, np.int64))

    def compile(self, robot: str, tube: Tube) -> None:
        """Ask everything once, so that no decision waits for machine code."""
        still = np.zeros(tube.points.shape[1])
        course = self.course(robot, tube, still, still, still + 1.0, 0)
        keeps_limits(still, still, 1.0, still, still, still, still + 1.0, still, still, 0.0, 0.0)
        course_points(tube.points, tube.points[:0], still, 1, 0)
        against = self.against(robot, [])
        self.certify(robot, lay_course(course, 0.0), against, 0.0, 0, tells=False)
        self.largest_share(course, 0.0, against, (None, self._every[:0]), 0.0, 0, 0, 0, 1)

    def course(
        self,
        robot: str,
        before: Tube,
        brake: Array,
        request: Array,
        max_dv: Array,
        longest_cycles: int,
    ) -> Course:
        """The robot's setpoints for every share from a brake (0) to a request (1), in the kernel's form.

        Args:
            robot: its name.
            before: its tube without the request; its points are the setpoints past and in flight.
            brake: (n,) increment at a share of 0 [rad or m].
            request: (n,) increment at a share of 1.
            max_dv: (n,) largest change of the increment between two cycles.
            longest_cycles: length of the longest brake after any share.
        """
        count = len(before.points)
        points = np.empty((count + longest_cycles, before.points.shape[1]))
        points[:count] = before.points
        return Course(
            points,
            count,
            before.first,
            before.lag,
            before.tolerance,
            before.spread,
            brake,
            request,
            max_dv,
            np.empty_like(brake),
            *self._ranges[robot],
        )

    def asks_a_depth(self, room_m: float) -> bool:
        """Whether some bodies may be in one another, which only coal can judge."""
        return self._least_stop_m + room_m <= 0.0

    def against(self, robot: str, others: Sequence[tuple[str, Tube]]) -> Against:
        """The bodies that a tube is checked against: structure, the robot itself, and tubes of other robots."""
        joints, bodies = self._ranges[robot]
        rows = [(0, 0, 0, 0, 0, *joints, *bodies, *_range(self._alone[robot]), _ALONE)]
        end = 0
        for name, tube in others:
            begin, end = end, end + len(tube.points)
            asked = _range(self._between[robot, name])
            windows = (tube.lag, tube.first, tube.last)
            rows.append((begin, end, *windows, *tube.joints, *tube.bodies, *asked, self._number[name]))
        tolerance, spread = np.zeros((len(rows), self._widest)), np.zeros(len(rows))
        for number, (_, tube) in enumerate(others, start=1):
            tolerance[number, : len(tube.tolerance)], spread[number] = tube.tolerance, tube.spread
        points = self._side_by_side([tube.points for _, tube in others])
        return Against(points, np.array(rows, np.int64), tolerance, spread)

    def certify(
        self, robot: str, mine: Tube, against: Against, room_m: float, budget: int, tells: bool
    ) -> WholeCertificate:
        """Certify that a robot keeps `room_m` beyond every stop distance in its whole tube.

        Args:
            robot: its name.
            mine: its tube.
            against: tubes and bodies against which it is checked.
            room_m: clearance required beyond each stop distance; their sum is positive [m].
            budget: how many pairs may be searched in parts of the tubes.
            tells: whether the tightest pair is asked for.
        """
        tubes = len(against.tubes)
        if tubes > len(self._told.pair):
            self._told = _told(2 * tubes, len(self._q))
        arrays, told = self._arrays, self._told
        failed, left, too_near, first, last = certify_all(
            arrays.anatomy,
            arrays.where,
            mine,
            against,
            self._pairs,
            self._every,
            room_m,
            budget,
            tells,
            arrays.stack,
            arrays.found,
            told,
        )
        self._forget()
        if failed == NONE:
            if not tells:
                return WholeCertificate(True, left, None, 0.0, None, None)
            return WholeCertificate(True, left, *self._tightest(against, range(tubes)), None, None)
        other = None if failed == 0 else list(self._ranges)[against.tubes[failed, 11]]
        listed = self._alone[robot] if other is None else self._between[robot, other]
        open_ = arrays.stack.chosen[first:last].copy()
        nearest: tuple[Nearest | None, float] = (None, 0.0)
        if tells:
            nearest = self._tightest(against, (failed,), open_ if too_near else ())
        failing = pairs_alone(listed, open_ - int(listed.numbers[0]))
        return WholeCertificate(False, left, *nearest, failing, other)

    def largest_share(
        self,
        course: Course,
        refused: float,
        against: Against,
        suspects: tuple[str | None, Integers],
        room_m: float,
        budget: int,
        trial_budget: int,
        halvings: int,
        rounds: int,
    ) -> tuple[float, int]:
        """The largest certified share of a request that the search finds, 0 if none; and the remaining budget.

        Args:
            course: of the request.
            refused: a share that could not be certified.
            against: tubes and bodies against which the robot's tube is checked.
            suspects: the pairs at which that failed: the other robot, if any, and the numbers of the pairs.
            room_m: clearance required beyond each stop distance; their sum is positive [m].
            budget: how many pairs may be searched in parts of the tubes, for all shares together.
            trial_budget: the part of it that one trial of suspects may spend on one other tube.
            halvings: how finely a share is searched.
            rounds: searches that end with a certificate.
        """
        if len(self._suspected.robot) < rounds:
            most = rounds * len(self._every)
            self._suspected = Suspected(*(np.zeros(size, np.int64) for size in (most, rounds + 1, rounds)))
        other, numbers = suspects
        self._suspected.pairs[: len(numbers)] = numbers
        self._suspected.end[1] = len(numbers)
        self._suspected.robot[0] = _ALONE if other is None else self._number[other]
        arrays = self._arrays
        share, left = largest_share(
            arrays.anatomy,
            arrays.where,
            course,
            refused,
            against,
            self._pairs,
            self._every,
            room_m,
            budget,
            trial_budget,
            halvings,
            rounds,
            False,
            self._suspected,
            arrays.stack,
            arrays.found,
            self._told,
        )
        self._forget()
        return float(share), left

    def _tightest(
        self, against: Against, tubes: Sequence[int], open_: Sequence[int] | Integers = ()
    ) -> tuple[Nearest | None, float]:
        """The pair with the least room of some tubes, and its stop distance [m]; open pairs may be in one another."""
        told = self._told
        asked = [tube for tube in tubes if told.pair[tube] != NONE]
        if not asked:
            return None, 0.0
        least = min(asked, key=lambda tube: told.most_m[tube])
        measured: list[tuple[Nearest, float]] = []
        for tube in asked:
            # coal would find it to have more room than another; that other one is measured whatever its bounds say
            if tube != least and told.least_m[tube] > told.most_m[least] + _APART_M:
                continue
            for side, joint in ((0, 5), (1, 5)):
                first, last = against.tubes[0 if side == 0 else tube, joint : joint + 2]
                if side == 0 or tube > 0:
                    self._q[first:last] = told.middle[tube, side, : last - first]
            self._meter.place(self._q)
            measured.append(self._measure(told.pair[tube], float(told.travel_m[tube])))
            found = self._arrays.found
            # of bodies in one another only coal tells how deep they are
            deepest = [index for index in open_ if found.at_most_m[index] < OVERLAP_M]
            measured += [self._measure(index, float(found.travel_m[index])) for index in deepest]
        return min(measured, key=lambda item: item[0].swept_m - item[1])

    def _measure(self, pair: int, travel_m: float) -> tuple[Nearest, float]:
        return self._meter.measure(int(pair), travel_m), float(self._pairs.stop_m[pair])

    def _side_by_side(self, points: Sequence[Array]) -> Array:
        """Setpoints of several robots one after another, zeros where a robot has fewer joints than others."""
        if len(points) == 1:
            return points[0]
        every = np.zeros((sum(map(len, points)), self._widest))
        end = 0
        for one in points:
            begin, end = end, end + len(one)
            every[begin:end, : one.shape[1]] = one
        return every


def _range(listed: PairedGroups) -> tuple[int, int]:
    """Where the pairs of one of a cell's own lists begin and end among all."""
    first = int(listed.numbers[0]) if len(listed.numbers) else 0
    return first, first + len(listed.numbers)


def _told(tubes: int, joints: int) -> Told:
    return Told(
        pair=np.zeros(tubes, np.int64),
        travel_m=np.zeros(tubes),
        least_m=np.zeros(tubes),
        most_m=np.zeros(tubes),
        middle=np.zeros((tubes, 2, joints)),
    )


class Meter:
    """Measures pairs at the middle of the boxes where robots are placed, without any inflation.

    Args:
        model: of all robots.
        bodies: all bodies of the cell, the shapes their own.
        pairs: (pairs, 2) numbers of bodies.
    """

    def __init__(self, model: Any, bodies: Sequence[Any], pairs: NDArray[np.int64]) -> None:
        self._model, self._data = model, model.createData()
        self._geometry = pin.GeometryModel()
        for body in bodies:
            own = pin.GeometryObject(body.name, body.parentJoint, body.placement, body.geometry.clone())
            own.geometry.setSweptSphereRadius(0.0)
            self._geometry.addGeometryObject(own)
        # the bodies of two robots are paired from either side, and measured from one
        numbers: dict[tuple[int, int], int] = {}
        for first, second in np.sort(pairs, axis=1).tolist():
            numbers.setdefault((first, second), len(numbers))
        for first, second in numbers:
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
        self._number = [numbers[min(pair), max(pair)] for pair in map(tuple, pairs.tolist())]
        self._turned = (pairs[:, 0] > pairs[:, 1]).tolist()
        self._names = [(bodies[first].name, bodies[second].name) for first, second in pairs.tolist()]
        self._placed = self._geometry.createData()
        make_reproducible(self._placed)

    def place(self, q: Array) -> None:
        """Place all robots at `q`, in the order of the model."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)

    def measure(self, pair: int, travel_m: float) -> Nearest:
        """Measure a pair whose bodies travel together by `travel_m`."""
        number = self._number[pair]
        pin.computeDistance(self._geometry, self._placed, number)
        result = self._placed.distanceResults[number]
        points = (np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2()))
        distance: float = result.min_distance
        return Nearest(
            self._names[pair], distance - travel_m, distance, points[::-1] if self._turned[pair] else points
        )


@dataclass(frozen=True)
class Division:
    """Result of dividing tubes.

    Attributes:
        holds: whether every pair keeps the requested distance anywhere in them.
        left: remaining budget [searches].
        tightest: the pair with the least room, in the first look or in that which failed; None if there are none.
        stop_distance_m: of that pair [m].
        failing: the pairs that were left open where it failed; none if it holds.
    """

    holds: bool
    left: int
    tightest: Nearest | None
    stop_distance_m: float
    failing: Sequence[Group]
