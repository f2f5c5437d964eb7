"""Distances between the swept bodies of a cell: the paper's CRASH, made to certify tubes.

Every robot is placed at the middle of a box in joint space, and every body of it is inflated by how far any
of its points can travel while the joints stay in that box. What coal then measures between two inflated
bodies is a lower bound of their distance at every configuration of the box.

Travel of a body, for joint half-widths h: `travel_i <= sum_j h_j * r_ij`, where r_ij is the largest distance of a
point of body i from the axis of joint j at the middle of the box (1 for a prismatic joint). It holds because
the joints can be moved one after the other from the base outwards: joint j then turns a chain whose outer
joints still stand at the middle, so that r_ij is exact, and a chord is shorter than its arc.
Of two bodies of one robot only the joints between them count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.bodies import Bodies
from deltaq_cell.cell_model import CellModel
from deltaq_cell.group import Group, Nearest
from deltaq_cell.joined import joined
from deltaq_cell.screen import ScreenedGroups, Surroundings
from deltaq_cell.self_groups import SelfGroups

Array = NDArray[np.float64]


@dataclass
class _Placed:
    """Where a robot was placed last, and how far its bodies travel there."""

    q: Array
    half: Array
    travel: Array
    centres: Array
    greatest: float
    among_themselves: bool = False

    def is_at(self, q: Array, half: Array) -> bool:
        """Whether it is there already."""
        return bool((self.q == q).all() and (self.half == half).all())


@dataclass(frozen=True)
class Look:
    """What a look at groups showed.

    Attributes:
        failing: groups with less room than asked for.
        tightest: the pair with the least room, and its stop distance [m].
    """

    failing: list[Group]
    tightest: Nearest
    stop_distance_m: float


class Proximity:
    """All bodies of a cell, placed and inflated at will.

    Attributes:
        names: the robots, in the cell's order.
        alone: per robot the groups of its links against the structure and against each other.
        between: per ordered pair of robots the groups of the first one's links against the second's.
    """

    def __init__(self, cell: CellModel) -> None:
        gate = cell.description.gate
        self.names = tuple(cell.robots)
        self.model, places = joined(cell)
        self._bodies = {name: Bodies(robot, places[name]) for name, robot in cell.robots.items()}
        self._data = self.model.createData()
        self._q = pin.neutral(self.model)
        self._placed: dict[str, _Placed] = {}
        self._around = Surroundings()
        if cell.structure:
            self._around.add_standing(cell.structure)
        self._slices = {
            name: self._around.add_moving(bodies.objects, bodies.radii)
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
        # only now are all bodies known that a screen may need
        self.alone = {name: ScreenedGroups(groups, self._around) for name, groups in self.alone.items()}
        self.between = {names: ScreenedGroups(groups, self._around) for names, groups in self.between.items()}

    def place(self, robot: str, q: Array, half: Array, among_themselves: bool = True) -> float:
        """Place a robot at `q` and inflate its bodies by their travel within `q` +- `half`.

        Args:
            robot: its name.
            q: (n,) middle of the box [rad or m].
            half: (n,) half-widths of the box, not negative.
            among_themselves: inflate for the groups of the robot against itself as well.

        Returns:
            The greatest travel of any of its bodies [m].
        """
        placed = self._placed.get(robot)
        if placed is None or not placed.is_at(q, half):
            placed = self._placed[robot] = self._move(robot, q, half)
        if among_themselves and not placed.among_themselves:
            self._self_groups[robot].inflate(placed.travel, placed.centres)
            placed.among_themselves = True
        return placed.greatest

    def least(self, group: Group) -> float:
        """Least swept distance of a group [m] where the robots have been placed."""
        return group.least(self.model, self._data)

    def look(self, groups: Sequence[Group], room_m: float) -> Look:
        """Find the groups with less than `room_m` beyond their stop distance, and the tightest pair of all.

        Groups that balls and boxes show to be far away are not measured, unless they could be the tightest.

        Args:
            groups: one of this object's own lists, or a few of their groups; not empty.
            room_m: what is asked for beyond each stop distance [m].
        """
        screen = groups.screen if isinstance(groups, ScreenedGroups) else None
        bounds = np.full(len(groups), -np.inf) if screen is None else screen.rooms()
        failing: list[Group] = []
        least_room, tightest = np.inf, groups[0]
        for index in np.argsort(bounds, kind="stable").tolist():
            if bounds[index] > max(room_m, least_room):
                break
            group = groups[index]
            room = self.least(group) - group.stop_distance_m
            if room < room_m:
                failing.append(group)
            if room < least_room:
                least_room, tightest = room, group
        return Look(failing, tightest.nearest(), tightest.stop_distance_m)

    def _move(self, robot: str, q: Array, half: Array) -> _Placed:
        bodies = self._bodies[robot]
        self._q[bodies.slice_q] = q
        J = pin.computeJointJacobians(self.model, self._data, self._q)[:, bodies.slice_q]
        travel = (
            bodies.lever_arms(J, self._data.oMi) * half if half.any() else np.zeros(bodies.moved_by.shape)
        )
        total = travel.sum(axis=1)
        centres = bodies.centres(self._data.oMi)
        bodies.inflate(total)
        self._around.centre[self._slices[robot]] = centres
        self._around.inflation[self._slices[robot]] = total
        return _Placed(q.copy(), half.copy(), travel, centres, float(total.max()))
