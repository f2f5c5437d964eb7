"""Distances between the swept bodies of a cell: the paper's CRASH, made to certify tubes.

Every robot is placed at the middle of a box in joint space, and every body of it is inflated by how far any
of its points can travel while the joints stay in that box. The distance that coal then measures between two
inflated bodies is a lower bound of theirs at every configuration of the box.

Travel of a body, for joint half-widths h: `travel_i <= sum_j h_j * r_ij`, where r_ij is the largest distance of a
point of body i from the axis of joint j at the middle of the box (1 for a prismatic joint). It holds because
the joints can be moved one after the other from the base outwards: joint j then turns a chain whose outer
joints still stand at the middle, so that r_ij is exact, and a chord is shorter than its arc.
For two bodies of one robot only the joints between them count. Pairs for which that is too coarse are checked
again with a plane between them (`deltaq_cell.separation`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import Bodies
from deltaq_cell.broad_phase import ScreenedGroups, Surroundings
from deltaq_cell.cell_model import CellModel
from deltaq_cell.composite_model import composite_model
from deltaq_cell.extents import Extents
from deltaq_cell.group import Group, Nearest
from deltaq_cell.self_groups import SelfGroups
from deltaq_cell.separation import Separation
from deltaq_protocol.arrays import Array


@dataclass
class _Placed:
    """Where a robot was placed last, and how far its bodies travel there."""

    span: tuple[Array, Array, Array, Array]
    J: Array
    travel: Array
    centres: Array
    greatest: float

    def is_at(self, span: tuple[Array, Array, Array, Array]) -> bool:
        """Whether the robot is placed there already."""
        return all(np.array_equal(mine, other) for mine, other in zip(self.span, span, strict=True))


def within_box(
    q: Array, half: Array, offsets: Array | None, deviation: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Copies of what describes a span; without offsets it is the whole box, a point as wide as the box."""
    if offsets is None or deviation is None:
        offsets, deviation = np.zeros((1, q.size)), half
    return q.copy(), half.copy(), offsets.copy(), deviation.copy()


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


class ProximityEngine:
    """All bodies of a cell, placed and inflated at will.

    Attributes:
        names: the robots, in the cell's order.
        alone: per robot the groups of its links against the structure and against each other.
        between: per ordered pair of robots the groups of the first one's links against the second's.
    """

    def __init__(self, cell: CellModel) -> None:
        gate = cell.description.gate
        self.names = tuple(cell.robots)
        self.model, places = composite_model(cell)
        self._bodies = {name: Bodies(robot, places[name]) for name, robot in cell.robots.items()}
        self._data = self.model.createData()
        self._q = pin.neutral(self.model)
        self._placed: dict[str, _Placed] = {}
        self._around = Surroundings()
        self._separation = Separation(self.model.nv)
        if cell.structure:
            self._around.add_standing(cell.structure)
            self._separation.add([body.name for body in cell.structure], Extents(cell.structure))
        self._slices = {
            name: self._around.add_moving(bodies.objects, bodies.radii)
            for name, bodies in self._bodies.items()
        }
        self._places = {
            name: self._separation.add(
                [body.name for body in bodies.objects], bodies.extents, bodies.slice_q, bodies.moved_by
            )
            for name, bodies in self._bodies.items()
        }
        self.alone: dict[str, list[Group]] = {}
        self.between: dict[tuple[str, str], list[Group]] = {}
        self._self_groups: dict[str, SelfGroups] = {}
        for name, bodies in self._bodies.items():
            never = frozenset(frozenset(pair) for pair in cell.robots[name].never_checked_pairs())
            moving = [link for link in bodies.links if bodies.moved_by[link[0]].any()]
            self._self_groups[name] = SelfGroups(bodies, never, gate.self_stop_distance_m, self._around)
            to_structure = [
                Group(bodies.on(link), [body], never, gate.stop_distance_m)
                for link in moving
                for body in cell.structure
            ]
            self.alone[name] = [g for g in to_structure if g.pairs] + self._self_groups[name].groups
            for other, theirs in self._bodies.items():
                if other != name:
                    self.between[name, other] = [
                        Group(bodies.on(mine), theirs.on(link), frozenset(), gate.stop_distance_m)
                        for mine in bodies.links
                        for link in theirs.links
                    ]
        self._moved_by = {
            name: {body.name: row for body, row in zip(bodies.objects, bodies.moved_by, strict=True)}
            for name, bodies in self._bodies.items()
        }
        self._numbers = {
            group: self._separation.pair_up([(one.name, other.name) for one, other in group.pairs])
            for groups in (*self.alone.values(), *self.between.values())
            for group in groups
        }
        self._pairs: dict[tuple[Group, int], Group] = {}
        # only now are all bodies known that a screen may need
        self.alone = {name: ScreenedGroups(groups, self._around) for name, groups in self.alone.items()}
        self.between = {names: ScreenedGroups(groups, self._around) for names, groups in self.between.items()}

    def place(
        self, robot: str, q: Array, half: Array, offsets: Array | None = None, deviation: Array | None = None
    ) -> float:
        """Place a robot at `q` and inflate its bodies by their travel within `q` +- `half`.

        Args:
            robot: its name.
            q: (n,) middle of the box [rad or m].
            half: (n,) its half-widths, not negative.
            offsets: (vertices, n) from `q` of the vertices of a span within that box; None if it may be anywhere in it.
            deviation: (n,) how far that span is wide.

        Returns:
            The greatest travel of any of its bodies [m].
        """
        span = within_box(q, half, offsets, deviation)
        placed = self._placed.get(robot)
        if placed is None or not placed.is_at(span):
            placed = self._placed[robot] = self._move(robot, *span)
            self._self_groups[robot].inflate(placed.travel, placed.centres)
        return placed.greatest

    def least(self, group: Group) -> float:
        """Least swept distance of a group [m] where the robots have been placed."""
        return group.least(self.model, self._data)

    def look(self, groups: Sequence[Group], room_m: float) -> DistanceQuery:
        """Find the groups with less than `room_m` beyond their stop distance, and the tightest pair of all.

        Groups that spheres and boxes show to be far away are not measured, unless they could be the tightest.

        Args:
            groups: one of this object's own lists, or a few of their groups; not empty.
            room_m: distance that is required beyond each stop distance [m].
        """
        screen = groups.screen if isinstance(groups, ScreenedGroups) else None
        bounds = np.full(len(groups), -np.inf) if screen is None else screen.rooms()
        failing: list[Group] = []
        least_room, tightest = np.inf, None
        for index in np.argsort(bounds, kind="stable").tolist():
            if bounds[index] > max(room_m, least_room):
                break
            group = groups[index]
            if group.is_empty:
                continue
            room = self.least(group) - group.stop_distance_m
            if room < room_m:
                failing.append(group)
            if tightest is None or room < least_room:
                least_room, tightest = room, group
        failing, too_near = self._not_separated(failing, room_m)
        if tightest is None:
            return DistanceQuery([], False, None, 0.0)
        return DistanceQuery(failing, too_near, tightest.nearest(), tightest.stop_distance_m)

    def measured(self, groups: Iterable[Group]) -> Iterator[Group]:
        """The groups that are not empty, each with all pairs measured at the robots' present placement."""
        for group in groups:
            if not group.is_empty:
                self.least(group)
                yield group

    def pair(self, group: Group, index: int) -> Group:
        """One pair of a group as a group of its own, whose stop distance is the caller's to set.

        Args:
            group: one of those in `alone` or `between`.
            index: of the pair in it.
        """
        if (group, index) not in self._pairs:
            first, second = group.pairs[index]
            single = Group([first], [second], frozenset(), group.stop_distance_m)
            self._pairs[group, index] = single
            self._numbers[single] = self._numbers[group] + index
        return self._pairs[group, index]

    def leave_out(self, pairs: Iterable[tuple[str, str]], left_out: bool = True) -> None:
        """Leave some pairs of bodies out, or measure them again.

        Args:
            pairs: names of the bodies, in any order.
            left_out: whether they are left out from now on.
        """
        named = {frozenset(pair) for pair in pairs}
        for group in self._numbers:
            for index, (first, second) in enumerate(group.pairs):
                if frozenset((first.name, second.name)) in named:
                    (group.leave_out if left_out else group.take_in)(index)

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
        J = self._jacobian(robot)
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

    def _not_separated(self, groups: list[Group], room_m: float) -> tuple[list[Group], bool]:
        """Groups, just measured, that planes do not separate either; and `DistanceQuery.too_near`."""
        if not groups:
            return [], False
        near = [group.nearer(group.stop_distance_m + room_m) for group in groups]
        counts = [len(indices) for indices, _, _ in near]
        asked = np.repeat([group.stop_distance_m + room_m for group in groups], counts)
        distances = np.concatenate([distances for _, distances, _ in near])
        if np.any(distances < asked):
            return groups, True
        numbers = np.repeat([self._numbers[group] for group in groups], counts)
        numbers += np.concatenate([indices for indices, _, _ in near])
        normals = np.concatenate([normals for _, _, normals in near])
        kept = self._separation.keeps(numbers, normals, distances, asked)
        group_kept = np.logical_and.reduceat(kept, np.cumsum([0, *counts[:-1]]))
        return [group for group, is_kept in zip(groups, group_kept, strict=True) if not is_kept], False

    def _jacobian(self, robot: str) -> Array:
        """(6, n) geometric Jacobian of a robot at the world's origin where it is placed, linear rows first."""
        return self._placed[robot].J

    def _move(self, robot: str, q: Array, half: Array, offsets: Array, deviation: Array) -> _Placed:
        bodies = self._bodies[robot]
        self._q[bodies.slice_q] = q
        # of a cell with one joint pinocchio gives a vector
        J = np.reshape(pin.computeJointJacobians(self.model, self._data, self._q), (6, -1))[:, bodies.slice_q]
        corners, axes, centres = bodies.placed(self._data.oMi)
        arms = bodies.lever_arms(J, corners) if half.any() else np.zeros(bodies.moved_by.shape)
        places = self._places[robot]
        self._separation.move(places, corners, axes, bodies.slice_q, arms, J, half, offsets, deviation)
        travel = arms * half
        total = travel.sum(axis=1)
        bodies.inflate(total)
        self._around.centre[self._slices[robot]] = centres
        self._around.inflation[self._slices[robot]] = total
        return _Placed((q, half, offsets, deviation), J, travel, centres, float(total.max()))
