"""Distance checks of many pairs of bodies, and certificates of tubes, in machine code.

The kernel (`deltaq_cell.kernel`) computes poses, travel and bounds of distances; coal measures the tightest pair
exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.anatomy import anatomy_of, findings, placed_at_first
from deltaq_cell.cell_model import CellModel
from deltaq_cell.decisions import OVERLAP_M, Decisions, Division, KernelArrays, Meter
from deltaq_cell.group import Group, Nearest, PairedGroups, pairs_alone, part_of
from deltaq_cell.kernel.arrays import Pairs
from deltaq_cell.kernel.decision import certify
from deltaq_cell.kernel.gap import ROUNDING_M
from deltaq_cell.kernel.look import NONE, look, separate_pairs
from deltaq_cell.kernel.pieces import Tube, stack_of
from deltaq_cell.kernel.place import place, spread
from deltaq_cell.kernel.span import off_hull, span_around, widths
from deltaq_cell.proximity import ProximityEngine
from deltaq_cell.reach import reach_of
from deltaq_protocol.arrays import Array


@dataclass(frozen=True)
class DistanceQuery:
    """Result of a check of groups.

    Attributes:
        failing: groups that have not been shown to keep the required distance.
        too_near: whether a pair of them does not keep it even at the middle of the span.
        tightest: the pair with the least swept distance beyond its stop distance; None if all are left out.
        stop_distance_m: of that pair [m].
    """

    failing: list[Group]
    too_near: bool
    tightest: Nearest | None
    stop_distance_m: float


@dataclass(frozen=True)
class Approach:
    """Two near bodies, and how a robot's joints bring them nearer.

    Attributes:
        pair: their names.
        distance_m: their distance.
        stop_distance_m: least distance that they have to keep.
        per_joint: (n,) loss of distance per unit of each joint of the robot [m/rad or m/m].
    """

    pair: tuple[str, str]
    distance_m: float
    stop_distance_m: float
    per_joint: Array


class CompiledProximity(ProximityEngine):
    """All bodies of a cell, placed and looked at by the kernel.

    Attributes:
        decisions: whole certificates, and searches for a share of a request.
        reach: of each robot.
    """

    def __init__(self, cell: CellModel) -> None:
        super().__init__(cell)
        bodies = [*cell.structure, *(item for robot in self._bodies.values() for item in robot.objects)]
        numbers = {body.name: number for number, body in enumerate(bodies)}
        groups = [group for groups in (*self.alone.values(), *self.between.values()) for group in groups]
        pairs = np.array(
            [[numbers[body.name] for body in pair] for group in groups for pair in group.pairs],
            dtype=np.int64,
        ).reshape(-1, 2)
        self._first, self._second = pairs[:, 0].copy(), pairs[:, 1].copy()
        self._anatomy = anatomy_of(self.model, cell.structure, list(self._bodies.values()))
        self._where = placed_at_first(self._anatomy)
        self._ranges: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {}
        first = len(cell.structure)
        for name, robot in self._bodies.items():
            joints = robot.slice_q.start, robot.slice_q.stop
            self._ranges[name] = joints, (first, first + len(robot.objects))
            first += len(robot.objects)
        self.reach = {name: reach_of(self._anatomy, *ranges) for name, ranges in self._ranges.items()}
        self._meter = Meter(self.model, bodies, pairs)
        self._active = np.ones(len(pairs), dtype=bool)
        start = 0
        for group in groups:
            group.active = self._active[start : start + len(group.pairs)]
            start += len(group.pairs)
        alone = {name: self._listed(groups) for name, groups in self.alone.items()}
        between = {names: self._listed(groups) for names, groups in self.between.items()}
        self._found = findings(max(len(pairs), 1))
        self._spans: dict[str, tuple[Array, Array, Array, Array]] = {}
        self._every = np.ones(len(bodies), dtype=bool)
        self._stack = stack_of(self.model.nv, len(bodies), len(pairs))
        self._told: dict[str, bytes] = {}
        self._travel: dict[str, float] = {}
        self._moved: set[str] = set()
        self._is_measured = False
        for name, (joints, _) in self._ranges.items():
            q = self._q[joints[0] : joints[1]]
            self.place(name, q, np.zeros_like(q))
        self.decisions = Decisions(
            KernelArrays(self._anatomy, self._where, self._stack, self._found),
            self._paired(groups).pairs._replace(active=self._active),
            self._ranges,
            alone,
            between,
            self._meter,
            self.forget,
        )
        self.alone |= alone
        self.between |= between
        self._compile()

    def _compile(self) -> None:
        """Call everything once, so that no decision waits for machine code."""
        for groups in (*self.alone.values(), *self.between.values()):
            self.look(groups, 0.0)
            pairs = self._as_listed(groups).pairs
            separate_pairs(self._anatomy, self._where, pairs, np.arange(0), 0.0, self._found)
        for name, (middle, *_) in self._spans.items():
            tube = self.whole_tube(name, middle[None], 0, 0, 0, np.ones_like(middle), 0.0)
            self.certify(tube, None, self.alone[name], 0.0, 0)
            self.decisions.compile(name, tube)
        span_around(self._q[None])
        off_hull(self._q[None], self._q, widths(self._q[None], self._q, 0.0) + 1.0)

    def place(
        self, robot: str, q: Array, half: Array, offsets: Array | None = None, deviation: Array | None = None
    ) -> float:
        """Place a robot in a span of joint space; the kernel uses it at once, coal at its next measurement.

        Args:
            robot: its name.
            q: (n,) middle of the box around the span [rad or m].
            half: (n,) its half-widths, not negative.
            offsets: (vertices, n) from `q` of the span's vertices; None if the robot may be anywhere in the box.
            deviation: (n,) how far the span is wide.

        Returns:
            The greatest travel of any of its bodies [m].
        """
        if offsets is None or deviation is None:
            offsets, deviation = np.zeros((1, q.size)), half
        span = q.copy(), half.copy(), offsets.copy(), deviation.copy()
        told = b"".join(array.tobytes() for array in span)
        if self._told.get(robot) == told:
            return self._travel[robot]
        self._told[robot] = told
        middle, half, offsets, deviation = self._spans[robot] = span
        joints, bodies = self._ranges[robot]
        self._q[joints[0] : joints[1]] = q
        cell, where = self._anatomy, self._where
        greatest = self._travel[robot] = place(cell, where, joints, bodies, self._every, middle, half)
        spread(cell, where, joints, bodies, offsets, len(offsets), deviation)
        self._moved.add(robot)
        self._is_measured = False
        return greatest

    def least(self, group: Group) -> float:
        """Least swept distance of a group [m] where the robots have been placed, as coal measures it."""
        for name in sorted(self._moved):
            super().place(name, *self._spans[name][:2])
        self._moved.clear()
        return super().least(group)

    def look(self, groups: Sequence[Group], room_m: float) -> DistanceQuery:
        """Find the groups with less than `room_m` beyond their stop distance, and the tightest pair of all.

        Args:
            groups: one of this object's own lists, the failing groups of a look, or a few of its groups; not empty.
            room_m: clearance required beyond each stop distance [m].
        """
        listed = self._as_listed(groups)
        if not listed.numbers.size:
            return DistanceQuery([], False, None, 0.0)
        self._found.open[: listed.numbers.size] = False
        chosen = np.flatnonzero(listed.pairs.active)
        asked = self._anatomy, self._where, listed.pairs, chosen, room_m
        tightest, any_open, too_near, _ = look(*asked, True, True, self._found)
        if any_open and not too_near:
            separate_pairs(*asked, self._found)
        if tightest == NONE:
            return DistanceQuery([], False, None, 0.0)
        open_ = np.flatnonzero(self._found.open[: listed.numbers.size])
        told = self._measure(listed, tightest)
        overlapping = open_[self._found.at_most_m[open_] < OVERLAP_M].tolist()
        if too_near:
            others = [self._measure(listed, index) for index in overlapping]
            told = min(told, *others, key=lambda item: item[0].swept_m - item[1]) if others else told
        elif kept := [index for index in overlapping if self._keeps_depth(listed, index, room_m)]:
            self._found.open[kept] = False
            open_ = np.setdiff1d(open_, kept)
        return DistanceQuery(part_of(listed, open_) if open_.size else [], too_near, *told)

    def approaches(self, robot: str, groups: Sequence[Group], distance_m: float) -> list[Approach]:
        """Pairs nearer than `distance_m` where the robots are placed, each as one point.

        Args:
            robot: name of the robot whose joints count.
            groups: one of this object's own lists for that robot, not empty.
            distance_m: beyond it pairs are left out.
        """
        room_m = distance_m - min(group.stop_distance_m for group in groups)
        near = [
            (group, item)
            for group in self.measured(self.look(groups, room_m).failing)
            for item in group.measured().values()
            if item.distance_m < distance_m
        ]
        begin, end = self._ranges[robot][0]
        J = self._where.columns[begin:end].T
        found = []
        for group, item in near:
            first, second = item.points_m
            along = (second - first) / max(item.distance_m, 1e-9)
            closing = np.zeros(J.shape[1])
            for name, point, side in ((item.pair[0], first, 1.0), (item.pair[1], second, -1.0)):
                if (moved_by := self._moved_by[robot].get(name)) is not None:
                    velocity = J[:3] + np.cross(J[3:].T, point).T
                    closing += side * (along @ velocity) * moved_by
            found.append(Approach(item.pair, item.distance_m, group.stop_distance_m, closing))
        return found

    def whole_tube(
        self, robot: str, points: Array, lag: int, first: int, last: int, tolerance: Array, spread: float
    ) -> Tube:
        """A robot's tube in the kernel's form.

        Args:
            robot: its name.
            points: (k, n) setpoints, past and to come [rad or m].
            lag: how many setpoints back the drives may be.
            first: the first window.
            last: the last window.
            tolerance: (n,) how far each joint may be beside the hull of its setpoints at rest [rad or m].
            spread: half of the greatest difference between the lags of two joints [cycles].
        """
        return Tube(points, lag, first, last, tolerance, spread, *self._ranges[robot])

    def keep_a_depth(self, groups: Sequence[Group], room_m: float) -> bool:
        """Whether a group is allowed to overlap (stop distance plus `room_m` at most 0): work for coal."""
        stops = self._as_listed(groups).pairs.stop_m
        return bool(stops.size) and bool(stops.min() + room_m <= 0.0)

    def certify(
        self,
        mine: Tube,
        theirs: Tube | None,
        groups: Sequence[Group],
        room_m: float,
        budget: int,
        tells: bool = True,
    ) -> Division:
        """Certify that groups keep `room_m` beyond their stop distance anywhere in one tube or two.

        Afterwards no robot counts as placed.

        Args:
            mine: tube of one robot.
            theirs: tube of another; None if the groups are of the one robot and what stands.
            groups: one of this object's own lists, or a few of their groups.
            room_m: clearance required beyond each stop distance; their sum is positive [m].
            budget: how many pairs may be searched in parts of the tubes and be followed by others.
            tells: whether the tightest pair is to be returned.
        """
        listed = self._as_listed(groups)
        other = Tube(mine.points[:0], 0, 0, 0, *mine[4:]) if theirs is None else theirs
        self.forget()
        verdict = certify(
            self._anatomy,
            self._where,
            mine,
            other,
            listed.pairs,
            np.arange(len(listed.numbers)),
            room_m,
            budget,
            tells,
            self._stack,
            self._found,
        )
        open_ = self._stack.chosen[verdict.first_open : verdict.last_open]
        failing = pairs_alone(listed, open_) if open_.size else []
        if verdict.told == NONE or not tells:
            return Division(verdict.holds, verdict.left, None, 0.0, failing)
        for tube, middle in zip((mine, other), self._stack.told, strict=True):
            if len(tube.points):
                first, last = tube.joints
                self._q[first:last] = middle[: last - first]
        told = self._measure(listed, verdict.told, verdict.travel_m)
        deepest = open_[self._found.at_most_m[open_] < OVERLAP_M].tolist() if verdict.too_near else []
        for index in deepest:  # of bodies in one another only coal tells how deep they are
            told = min(told, self._measure(listed, index), key=lambda item: item[0].swept_m - item[1])
        return Division(verdict.holds, verdict.left, *told, failing)

    def forget(self) -> None:
        """No robot counts as placed or measured."""
        self._told.clear()
        self._is_measured = False

    def _listed(self, groups: Sequence[Group]) -> PairedGroups:
        """One of this object's own lists, whose groups are numbered one after the other."""
        paired = self._paired(groups)
        first = int(paired.numbers[0]) if groups else 0
        # pairs that a group leaves out are left out here, too
        active = self._active[first : first + len(paired.numbers)]
        return PairedGroups(groups, paired.numbers, paired.group, paired.pairs._replace(active=active))

    def _as_listed(self, groups: Sequence[Group]) -> PairedGroups:
        return groups if isinstance(groups, PairedGroups) else self._paired(groups)

    def _paired(self, groups: Sequence[Group]) -> PairedGroups:
        counts = [len(group.pairs) for group in groups]
        starts = [self._numbers[group] - sum(counts[:index]) for index, group in enumerate(groups)]
        numbers = np.repeat(np.array(starts, dtype=np.int64), counts) + np.arange(sum(counts))
        pairs = Pairs(
            self._first[numbers],
            self._second[numbers],
            np.repeat(np.array([group.stop_distance_m for group in groups]), counts),
            np.concatenate([group.active for group in groups]) if groups else np.empty(0, dtype=bool),
        )
        return PairedGroups(groups, numbers, np.repeat(np.arange(len(groups)), counts), pairs)

    def _measure(
        self, listed: PairedGroups, index: int, travel_m: float | None = None
    ) -> tuple[Nearest, float]:
        """Measure a pair, by its index in a list that was looked at; and its stop distance [m].

        `travel_m` is the travel of both bodies together; by default that of the last look.
        """
        if not self._is_measured:
            self._meter.place(self._q)
            self._is_measured = True
        travel_m = float(self._found.travel_m[index]) if travel_m is None else travel_m
        nearest = self._meter.measure(int(listed.numbers[index]), travel_m)
        return nearest, float(listed.pairs.stop_m[index])

    def _keeps_depth(self, listed: PairedGroups, index: int, room_m: float) -> bool:
        """Whether bodies in one another get no deeper than is allowed, by planes along coal's way out of one another.

        The kernel's search ends where bodies overlap, and leaves a direction along which they may be far deeper.
        """
        asked_m = float(listed.pairs.stop_m[index]) + room_m
        nearest, _ = self._measure(listed, index)
        if asked_m >= 0.0 or nearest.distance_m >= 0.0:
            return False
        first, second = nearest.points_m
        normal = (second - first) / nearest.distance_m
        length = float(np.linalg.norm(normal))
        if not 0.5 < length < 2.0:  # coal found no way out
            return False
        found = self._found
        found.open[index], found.normal[index] = True, normal / length
        found.at_most_m[index] = nearest.distance_m + ROUNDING_M
        separate_pairs(self._anatomy, self._where, listed.pairs, np.array([index]), room_m, found)
        return not found.open[index]
