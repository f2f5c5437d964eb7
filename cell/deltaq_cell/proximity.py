"""Distances between swept bodies of a cell, measured by coal: the paper's CRASH, extended to certify tubes.

Every robot is placed at the middle of a box in joint space, and every body of it is inflated by how far any
of its points can travel while the joints stay in that box. The distance that coal then measures between two
inflated bodies is a lower bound of theirs at every configuration of the box.

Travel of a body, for joint half-widths h: `travel_i <= sum_j h_j * r_ij`, where r_ij is the largest distance of a
point of body i from the axis of joint j at the middle of the box (1 for a prismatic joint). It holds because the
joints can be moved one after the other from the base outwards: joint j then turns a chain whose outer joints still
stand at the middle, so that r_ij is exact, and a chord is shorter than its arc. For two bodies of one robot only the
joints between them count.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import Bodies, composite_model
from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import Group, Names
from deltaq_protocol.arrays import Array


class SelfGroups:
    """Pairs of links of one robot: their relative travel comes only from the joints between them.

    The bodies are clones, since their radii differ from the ones against the rest of the world.

    Attributes:
        groups: one for each two links that are checked.
        clones: their bodies.
        sources: index of the body of which each is a clone.
    """

    def __init__(self, bodies: Bodies, never: Names, stop_distance_m: float) -> None:
        self.groups: list[Group] = []
        self.clones: list[Any] = []
        self.sources: list[int] = []
        joints = []
        for inner, outer in combinations(bodies.links, 2):
            clones = {index: _clone(bodies.objects[index]) for index in (*outer, *inner)}
            group = Group([clones[i] for i in outer], [clones[i] for i in inner], never, stop_distance_m)
            if not group.pairs:
                continue
            self.groups.append(group)
            for mine, theirs in ((outer, inner), (inner, outer)):
                self.clones += [clones[i] for i in mine]
                self.sources += mine
                joints += [bodies.moved_by[mine[0]] & ~bodies.moved_by[theirs[0]]] * len(mine)
        self._shapes = [clone.geometry for clone in self.clones]
        self._joints = np.array(joints).reshape(len(joints), bodies.moved_by.shape[1])

    def inflate(self, travel: Array) -> Array:
        """Inflate the clones by their part of `travel` (bodies, n) [m]; returns their inflation (clones,) [m]."""
        radii: Array = (travel[self.sources] * self._joints).sum(axis=1)
        for shape, radius in zip(self._shapes, radii.tolist(), strict=True):
            shape.setSweptSphereRadius(radius)
        return radii


def _clone(item: Any) -> Any:
    return pin.GeometryObject(item.name, item.parentJoint, item.placement, item.geometry.clone())


class ProximityEngine:
    """All bodies of a cell; the caller places and inflates them, coal measures their distances.

    Attributes:
        model: all robots in one, in the cell's order.
        alone: per robot the groups of its links against the structure and against each other.
        between: per ordered pair of robots the groups of the first one's links against the second's.
    """

    def __init__(self, cell: CellModel) -> None:
        gate = cell.description.gate
        self.model, places = composite_model(cell)
        self._bodies = {name: Bodies(robot, places[name]) for name, robot in cell.robots.items()}
        self._data = self.model.createData()
        self._q = pin.neutral(self.model)
        self._placed: dict[str, tuple[Array, Array]] = {}
        self._greatest: dict[str, float] = {}
        self.alone: dict[str, list[Group]] = {}
        self.between: dict[tuple[str, str], list[Group]] = {}
        self._self_groups: dict[str, SelfGroups] = {}
        for name, bodies in self._bodies.items():
            never = frozenset(frozenset(pair) for pair in cell.robots[name].never_checked_pairs())
            moving = [link for link in bodies.links if bodies.moved_by[link[0]].any()]
            self._self_groups[name] = SelfGroups(bodies, never, gate.self_stop_distance_m)
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
        # the number of each group's first pair among all
        self._numbers: dict[Group, int] = {}
        count = 0
        for groups in (*self.alone.values(), *self.between.values()):
            for group in groups:
                self._numbers[group] = count
                count += len(group.pairs)
        self._pairs: dict[tuple[Group, int], Group] = {}

    def place(self, robot: str, q: Array, half: Array) -> float:
        """Place a robot at `q` and inflate its bodies by their travel within `q` +- `half`.

        Args:
            robot: its name.
            q: (n,) middle of the box [rad or m].
            half: (n,) its half-widths, not negative.

        Returns:
            The greatest travel of any of its bodies [m].
        """
        placed = self._placed.get(robot)
        if placed is None or not (np.array_equal(placed[0], q) and np.array_equal(placed[1], half)):
            self._placed[robot] = q.copy(), half.copy()
            self._greatest[robot] = self._move(robot, q, half)
        return self._greatest[robot]

    def least(self, group: Group) -> float:
        """Least swept distance of a group [m] where the robots have been placed."""
        return group.least(self.model, self._data)

    def measured(self, groups: Iterable[Group]) -> Iterator[Group]:
        """The groups that are not empty, each with all pairs measured at the robots' present placement."""
        for group in groups:
            if not group.is_empty:
                self.least(group)
                yield group

    def pair(self, group: Group, index: int) -> Group:
        """One pair of a group as a new group; the caller may set its stop distance.

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

    def leave_out_bodies(self, bodies: frozenset[str], left_out: bool = True) -> None:
        """Leave every pair of some bodies out, or measure them again."""
        if not bodies:
            return
        for group in self._numbers:
            for index, pair in enumerate(group.pairs):
                if not bodies.isdisjoint((pair[0].name, pair[1].name)):
                    (group.leave_out if left_out else group.take_in)(index)

    def _move(self, robot: str, q: Array, half: Array) -> float:
        bodies = self._bodies[robot]
        self._q[bodies.slice_q] = q
        # of a cell with one joint pinocchio gives a vector
        J = np.reshape(pin.computeJointJacobians(self.model, self._data, self._q), (6, -1))[:, bodies.slice_q]
        corners = bodies.corners_in_world(self._data.oMi)
        arms = bodies.lever_arms(J, corners) if half.any() else np.zeros(bodies.moved_by.shape)
        travel = arms * half
        total = travel.sum(axis=1)
        bodies.inflate(total)
        self._self_groups[robot].inflate(travel)
        return float(total.max())
