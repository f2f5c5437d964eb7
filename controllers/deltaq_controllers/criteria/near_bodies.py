"""The bodies that a robot's own are near to, by the exact shapes that the gate uses, for criteria of clearance.

The pairs are of three kinds: the robot with itself, with the structure, and with other robots. A pair whose distance
the hands' poses fix, such as a gripper and the workpiece, is left out: no configuration changes it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations
from typing import Any, NamedTuple, Self

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.bodies import WORLD, composite_model, corners_of
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled import compiled, inlined
from deltaq_cell.group import make_reproducible
from deltaq_controllers.kinematics import placement_views
from deltaq_controllers.spheres import local_box
from deltaq_protocol.arrays import Array, Flags, Indices

# Broad phase: the pairs of bodies that may be near, and so need a measurement with exact shapes.
#
# A body is enclosed in a capsule, a fixed box is a box, and their distance is never more than that of the
# bodies. Compiled, because a path is a thousand configurations of a thousand pairs.


_THIRDS = 8
"""How often the piece of an axis that holds its nearest point to a box is cut by a third."""


class Screen(NamedTuple):
    """Enclosures of b bodies and the p pairs of them that count.

    Attributes:
        joints: (b,) index of the carrying joint, as pinocchio counts; 0 for the world.
        middles: (b, 3) middles of the capsules' axes in the frames of these joints [m].
        halves: (b, 3) halves of the axes, as vectors [m].
        radii: (b,) their radii [m].
        is_box: (b,) whether the body is a box that stands still.
        turns: (b, 3, 3) rotation of such a box, in the world.
        sizes: (b, 3) halves of its size [m].
        first, second: (p,) bodies of each pair; where one is a box that stands still, it is the second.
    """

    joints: Indices
    middles: Array
    halves: Array
    radii: Array
    is_box: Flags
    turns: Array
    sizes: Array
    first: Indices
    second: Indices

    @classmethod
    def of(cls, bodies: list[Any], pairs: list[tuple[int, int]]) -> Self:
        """Enclose pinocchio's geometry objects; `pairs` are of their indices."""
        enclosed = [_enclosed(body) for body in bodies]
        is_box = np.array(
            [body.parentJoint == WORLD and isinstance(body.geometry, coal.Box) for body in bodies]
        )
        ordered = [(j, i) if is_box[i] else (i, j) for i, j in pairs]
        boxes = [local_box(body) for body in bodies]
        return cls(
            joints=np.array([int(body.parentJoint) for body in bodies], dtype=np.intp),
            middles=np.array([middle for middle, _, _ in enclosed]).reshape(-1, 3),
            halves=np.array([half for _, half, _ in enclosed]).reshape(-1, 3),
            radii=np.array([radius for _, _, radius in enclosed]),
            is_box=is_box,
            turns=np.array([body.placement.rotation for body in bodies]).reshape(-1, 3, 3),
            sizes=np.array([0.5 * (high - low) for low, high in boxes]).reshape(-1, 3),
            first=np.array([first for first, _ in ordered], dtype=np.intp),
            second=np.array([second for _, second in ordered], dtype=np.intp),
        )


def _enclosed(body: Any) -> tuple[Array, Array, float]:
    """Middle (3,), half axis (3,) and radius of a capsule around a body, in the frame of its joint [m]."""
    low, high = local_box(body)
    middle = np.array(body.placement.act(0.5 * (low + high)))
    shape = body.geometry
    if isinstance(shape, coal.Capsule | coal.Cylinder):
        return middle, shape.halfLength * body.placement.rotation[:, 2], float(shape.radius)
    if isinstance(shape, coal.Sphere):
        return middle, np.zeros(3), float(shape.radius)
    size = 0.5 * (high - low)
    along = int(np.argmax(size))
    axis = body.placement.rotation[:, along]
    points = corners_of(body)
    if isinstance(shape, coal.Convex):
        points = np.array([body.placement.act(shape.point(index)) for index in range(shape.num_points)])
    away = points - middle
    radius = float(np.linalg.norm(away - np.outer(away @ axis, axis), axis=1).max())
    return middle, size[along] * axis, radius


@compiled
def least_gaps(screen: Screen, placements: Array, within: Array) -> Array:
    """(p,) a distance that each pair has at least, infinite where it is no less than `within` (p,) [m].

    Args:
        screen: the bodies.
        placements: (4 n, 3) of the joints, as `kinematics.placement_views` has them.
        within: (p,) distances that matter [m].
    """
    count = len(screen.joints)
    middles, halves, reach = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    for i in range(count):
        joint = screen.joints[i]
        for axis in range(3):
            if joint == 0:
                middles[i, axis], halves[i, axis] = screen.middles[i, axis], screen.halves[i, axis]
            else:
                row = 4 * (joint - 1)
                middle, half = placements[row + 3, axis], 0.0
                for k in range(3):
                    middle += placements[row + k, axis] * screen.middles[i, k]
                    half += placements[row + k, axis] * screen.halves[i, k]
                middles[i, axis], halves[i, axis] = middle, half
        reach[i] = math.sqrt((screen.halves[i] ** 2).sum())
    found = np.full(len(screen.first), np.inf)
    for pair in range(len(found)):
        i, j = screen.first[pair], screen.second[pair]
        if screen.is_box[j]:
            thick = screen.radii[i]
            gap = _axis_from_box(screen, middles, halves, i, j, reach[i], within[pair] + thick)
        else:
            thick, apart = screen.radii[i] + screen.radii[j], 0.0
            for axis in range(3):
                apart += (middles[i, axis] - middles[j, axis]) ** 2
            near = within[pair] + thick + reach[i] + reach[j]
            if near <= 0.0 or apart >= near * near:
                continue
            gap = _axes_gap(middles, halves, i, j)
        if gap - thick < within[pair]:
            found[pair] = gap - thick
    return found


@compiled
def _axes_gap(middles: Array, halves: Array, i: int, j: int) -> float:
    """Distance of the axes of two bodies: of two segments, as in Ericson 2005, 5.1.9."""
    a = e = b = c = f = 0.0
    for k in range(3):
        between, h1, h2 = middles[i, k] - middles[j, k], halves[i, k], halves[j, k]
        a += h1 * h1
        e += h2 * h2
        b += h1 * h2
        c += h1 * between
        f += h2 * between
    determinant = a * e - b * b
    s = (b * f - c * e) / determinant if determinant > 1e-12 else -c / max(a, 1e-12)
    s = min(1.0, max(-1.0, s))
    free = (b * s + f) / max(e, 1e-12)
    t = min(1.0, max(-1.0, free))
    if t != free:
        s = min(1.0, max(-1.0, (b * t - c) / max(a, 1e-12)))
    squared = 0.0
    for k in range(3):
        squared += (middles[i, k] + s * halves[i, k] - middles[j, k] - t * halves[j, k]) ** 2
    return math.sqrt(squared)


@compiled
def _axis_from_box(
    screen: Screen, middles: Array, halves: Array, i: int, j: int, reach: float, within: float
) -> float:
    """A distance that the axis of body i has at least from box j, infinite where its middle shows `within`."""
    x, y, z = middles[i, 0] - middles[j, 0], middles[i, 1] - middles[j, 1], middles[i, 2] - middles[j, 2]
    turn = screen.turns[j]
    mx = turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z
    my = turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z
    mz = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
    sx, sy, sz = screen.sizes[j, 0], screen.sizes[j, 1], screen.sizes[j, 2]
    if _from_box(mx, my, mz, sx, sy, sz) - reach >= within:
        return math.inf
    x, y, z = halves[i, 0], halves[i, 1], halves[i, 2]
    hx = turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z
    hy = turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z
    hz = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
    # the distance is convex along the axis
    low, high = -1.0, 1.0
    for _ in range(_THIRDS):
        third = (high - low) / 3.0
        s, t = low + third, high - third
        before = _from_box(mx + s * hx, my + s * hy, mz + s * hz, sx, sy, sz)
        after = _from_box(mx + t * hx, my + t * hy, mz + t * hz, sx, sy, sz)
        if before <= after:
            high = t
        else:
            low = s
    s = 0.5 * (low + high)
    return _from_box(mx + s * hx, my + s * hy, mz + s * hz, sx, sy, sz) - 0.5 * (high - low) * reach


@inlined
def _from_box(x: float, y: float, z: float, sx: float, sy: float, sz: float) -> float:
    """Distance of a point in a box's frame from the box; 0 inside."""
    x, y, z = max(0.0, abs(x) - sx), max(0.0, abs(y) - sy), max(0.0, abs(z) - sz)
    return math.sqrt(x * x + y * y + z * z)


SOFT_M = 0.02
"""Pairs count that are nearer than the nearest of their kind and a few times this [m]."""
WINDOW_M = 3.0 * SOFT_M
"""Those farther off have less than a fiftieth of its weight [m]."""
FAR_M = 0.25
"""Room beyond which nothing is gained [m]."""


class PairKind(IntEnum):
    """The kind of body that a robot's body is near to."""

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
        row: (e,) index of the configuration.
        kind: (e,) kind of the pair.
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
        loose: hands that do not keep their pose.

    Attributes:
        names: names of the bodies of each pair.
        kinds: (p,) kind of each pair.
    """

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        others: Mapping[str, Array] | None = None,
        loose: Collection[str] = (),
    ) -> None:
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
        kept = [hand for hand in model.hands if hand not in loose]
        last = {int(model.model.frames[model.frame_of(hand)].parentJoint) - 1 for hand in kept}
        # a hand stays in place, and so do all bodies on its last joint
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
