"""What the gate's kernel computes, as readable code: looks at the bodies of a cell, and planes that keep them apart.

Nothing of the product runs it; tests hold the kernel against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.bodies import Extents, corners_of
from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import DistanceQuery
from deltaq_cell.group import Group
from deltaq_cell.proximity import ProximityEngine
from deltaq_protocol.arrays import Array, Flags, Indices

# Planes that keep bodies apart over a whole span of joint space.
#
# A span is `middle + sum_k a_k offset_k + e` with a_k >= 0, sum_k a_k = 1 and |e_j| <= `deviation_j`: the hull of a
# few vertices, and what lies a little beside it. Inflating a body by its travel (`deltaq_cell.proximity`) ignores
# the direction of its travel. Here n is the normal between the two bodies at the middle, and the gap along n is
# bounded over the span:
#
#     n . p(a, e) >= n . p + sum_k a_k n . (J offset_k) - sum_j deviation_j r_j - bend
#
# J is the Jacobian of the point at the middle, so the second term is signed: bodies that slide past one another or
# part lose nothing. It is linear in a, so that the gap over a whole body is least at a vertex. r_j is the greatest
# distance of a point of the body from the axis of joint j (1 for a prismatic joint), and `bend` bounds the second-
# order remainder, by Taylor's theorem with
#
#     |d2p / dq_j dq_k| <= r_k + travel,  k the outer of both; 0 if a prismatic joint is the inner one, or both,
#
# since while the joints move, no point's distance from an axis grows by more than it travels. Both sides of a plane
# are extreme points of whole bodies, so nothing rests on n being the best normal.
#
# A fixed plane loses to first order where an edge or a face lies along it and turns. So a plane may turn with one of
# the bodies, n(a) = n + sum_k a_k w_k x n with w_k the body's rotation from the middle to a vertex: that body's side
# then only shifts, and the other's is as exact as before. The products of two motions add at most the greatest |w_k
# x n| times the travel of each body, and n(a) is longer than one by less than half its square.

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


class Separation:
    """Bounds the gaps between bodies of a cell along given normals.

    Args:
        joints: how many joints all robots have together.
    """

    def __init__(self, joints: int) -> None:
        self._places: dict[str, int] = {}
        self._owner = np.empty(0, dtype=np.intp)
        self._moved_by = np.empty((0, joints), dtype=bool)
        self._corners = np.empty((0, 1, 3))
        self._axis = np.empty((0, 3))
        self._disc, self._ball = np.empty(0), np.empty(0)
        self._arms = np.empty((0, joints))
        self._columns = np.zeros((1, joints, 6))
        self._revolute = np.zeros(joints, dtype=bool)
        self._half, self._along, self._deviation = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._first = self._second = np.empty(0, dtype=np.intp)

    def add(
        self,
        names: Sequence[str],
        extents: Extents,
        joints: slice | None = None,
        moved_by: Flags | None = None,
    ) -> slice:
        """Add the bodies of one robot, or the standing bodies; returns their places.

        Args:
            names: of the bodies, unique in the cell.
            extents: of the bodies; those of standing bodies in the world.
            joints: the robot's joints among all.
            moved_by: (bodies, n) which joint moves which body.
        """
        first, count = len(self._disc), len(names)
        most = max(self._corners.shape[1], extents.corners.shape[1])
        moves = np.zeros((count, self._moved_by.shape[1]), dtype=bool)
        if joints is not None:
            moves[:, joints] = moved_by
        self._places |= {name: first + index for index, name in enumerate(names)}
        self._owner = np.append(self._owner, np.full(count, first))
        self._moved_by = np.vstack([self._moved_by, moves])
        self._corners = np.concatenate([_padded(self._corners, most), _padded(extents.corners, most)])
        self._axis = np.vstack([self._axis, extents.axis])
        self._disc, self._ball = np.append(self._disc, extents.disc), np.append(self._ball, extents.ball)
        self._arms = np.vstack([self._arms, np.zeros(moves.shape)])
        return slice(first, first + count)

    def pair_up(self, pairs: Sequence[tuple[str, str]]) -> int:
        """Add pairs of bodies by name; returns the number of the first of them."""
        number = len(self._first)
        places = np.array([[self._places[one], self._places[other]] for one, other in pairs], dtype=np.intp)
        self._first = np.append(self._first, places[:, 0])
        self._second = np.append(self._second, places[:, 1])
        return number

    def move(
        self,
        bodies: slice,
        corners: Array,
        axis: Array,
        joints: slice,
        arms: Array,
        J: Array,
        half: Array,
        offsets: Array,
        deviation: Array,
    ) -> None:
        """Place one robot's bodies.

        Args:
            bodies: their places.
            corners: (bodies, k, 3) in the world [m].
            axis: (bodies, 3) in the world.
            joints: the robot's joints among all.
            arms: (bodies, n) greatest distances from the joints' axes [m/rad or m/m].
            J: (6, n) geometric Jacobian at the world's origin, linear rows first.
            half: (n,) half-widths of the box around the span [rad or m].
            offsets: (vertices, n) of the span's vertices from the middle of that box [rad or m].
            deviation: (n,) how far the span is wide [rad or m].
        """
        self._corners[bodies, : corners.shape[1]] = corners
        self._corners[bodies, corners.shape[1] :] = corners[:, :1]
        self._axis[bodies] = axis
        self._arms[bodies, joints] = arms
        # a span of fewer vertices than another has its last one more than once
        self._columns = _repeated(self._columns, len(offsets))
        self._columns[:, joints] = _repeated(J.T * offsets[:, :, None], len(self._columns))
        self._revolute[joints] = J[3:].any(axis=0)
        self._half[joints], self._deviation[joints] = half, deviation
        self._along[joints] = np.abs(offsets).max(axis=0)

    def keeps(self, numbers: Indices, normals: Array, distances: Array, asked: Array) -> Flags:
        """Whether planes keep k pairs apart over the spans where their robots are placed.

        Args:
            numbers: (k,) numbers of the pairs.
            normals: (k, 3) unit vectors from the first body to the second.
            distances: (k,) at the middle of the spans; no plane can show more [m].
            asked: (k,) least distances to be shown [m].
        """
        pairs = np.stack([self._first[numbers], self._second[numbers]])
        moved_by = self._moved_by[pairs]
        # joints that move both bodies leave their distance as it is
        moves = moved_by & ~moved_by[::-1]
        asked = asked + self._blur(pairs, moves).sum(axis=0)
        if (distances < asked).all():
            return np.zeros(len(asked), dtype=bool)
        twists = moves @ self._columns[:, None]
        reached = self._reach(pairs, twists, np.stack([normals, -normals]), np.stack([normals, -normals]))
        # bodies of one robot are at the same place of its span
        together = self._owner[pairs[0]] == self._owner[pairs[1]]
        reach = np.where(together, reached.sum(axis=1).max(axis=0), reached.max(axis=0).sum(axis=0))
        kept: Flags = -reach >= asked
        for body in (0, 1):
            left = np.flatnonzero(~kept)
            if left.size:
                turning = pairs[:, left], moves[:, left], twists[:, :, left], normals[left], asked[left]
                kept[left] = self._kept_by_turning(body, together[left], *turning)
        return kept

    def _kept_by_turning(
        self,
        body: int,
        together: Flags,
        pairs: Indices,
        moves: Flags,
        twists: Array,
        normals: Array,
        asked: Array,
    ) -> Flags:
        """(k,) whether planes that turn with the first (0) or the second (1) body of each pair keep it apart."""
        turns = _cross(twists[:, body, :, 3:], normals)
        angle = np.sqrt(_dot(turns, turns)).max(axis=0)
        travel = _dot(self._arms[pairs] * moves, self._along).sum(axis=0)
        asked = np.maximum(asked, asked * np.sqrt(1.0 + angle**2)) + angle * travel
        kept = np.ones(len(asked), dtype=bool)
        for vertices in product(range(len(twists)), repeat=2):
            turned = normals + turns[vertices[body]]
            reach = sum(
                self._reach(pairs[side], twists[vertices[side], side], sign * normals, sign * turned)
                for side, sign in ((0, 1.0), (1, -1.0))
            )
            kept &= (-reach >= asked) | (together & (vertices[0] != vertices[1]))
        return kept

    def _reach(self, bodies: Indices, twists: Array, normals: Array, turned: Array) -> Array:
        """(..., k) how far (..., k) bodies reach, to first order [m].

        Args:
            bodies: their places.
            twists: (..., k, 6) from the middle of the span to a vertex, at the world's origin.
            normals: (..., k, 3) that are met by the motion.
            turned: (..., k, 3) along which they reach at the middle.
        """
        along = turned + _cross(normals, twists[..., 3:])
        reach: Array = (self._corners[bodies] @ along[..., None])[..., 0].max(axis=-1)
        axis = self._axis[bodies]
        across = along - _dot(axis, along)[..., None] * axis
        reach += self._disc[bodies] * np.sqrt(_dot(across, across))
        reach += self._ball[bodies] * np.sqrt(_dot(along, along))
        return reach + _dot(normals, twists[..., :3])

    def _blur(self, bodies: Indices, moved_by: Flags) -> Array:
        """(2, k) what deviation and bend may add to each side [m]."""
        arms = self._arms[bodies] * moved_by
        half = self._half * moved_by
        travel = _dot(half, arms)
        turns = half * self._revolute
        before = turns.cumsum(axis=-1) - turns
        bend = _dot(half * (arms + travel[..., None]), before + 0.5 * turns)
        blur: Array = arms @ self._deviation + bend
        return blur


def _repeated(rows: Array, count: int) -> Array:
    """The same rows, the last repeated until there are `count`."""
    missing = count - len(rows)
    return rows if missing <= 0 else np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)])


def _dot(a: Array, b: Array) -> Array:
    """Products of the last axes, as many as there are."""
    product: Array = np.einsum("...i,...i", a, b)
    return product


def _cross(a: Array, b: Array) -> Array:
    """Cross products of the last axes; numpy's own takes five times as long for so few."""
    product: Array = a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]
    return product


def _padded(corners: Array, most: int) -> Array:
    """The same corners, the first repeated until each body has `most`."""
    missing = most - corners.shape[1]
    return (
        corners
        if missing <= 0
        else np.concatenate([corners, np.repeat(corners[:, :1], missing, axis=1)], axis=1)
    )


# A quick bound for many pairs of bodies: which of them need not be measured?
#
# Around every body that moves there is a sphere, around every one that stands still a box along the world's axes. Their
# distance is a lower bound of the bodies', and for a thousand pairs at once it costs as much as measuring a few.


class Surroundings:
    """Balls and boxes around all bodies of a cell, kept up to date as robots are placed and inflated.

    Attributes:
        centre: (bodies, 3) in the world [m].
        half: (bodies, 3) half edges of the boxes of standing bodies, zero for spheres [m].
        radius: (bodies,) of the spheres, zero for boxes [m].
        inflation: (bodies,) travel that has been added [m].
    """

    def __init__(self) -> None:
        self._places: dict[int, int] = {}
        self._kept: list[Any] = []
        self.centre = np.empty((0, 3))
        self.half = np.empty((0, 3))
        self.radius = np.empty(0)
        self.inflation = np.empty(0)

    def add_moving(self, bodies: Sequence[Any], radii: Array) -> NDArray[np.intp]:
        """Add bodies with spheres (k,); returns their places."""
        zeros = np.zeros((len(bodies), 3))
        return self._add(bodies, zeros, zeros, radii)

    def add_standing(self, bodies: Sequence[Any]) -> None:
        """Add bodies that stand still in the world, with boxes."""
        corners = np.stack([corners_of(body) for body in bodies])
        low, high = corners.min(axis=1), corners.max(axis=1)
        self._add(bodies, (low + high) / 2, (high - low) / 2, np.zeros(len(bodies)))

    def place_of(self, body: Any) -> int:
        """Where a body is in the arrays."""
        return self._places[id(body)]

    def _add(self, bodies: Sequence[Any], centre: Array, half: Array, radius: Array) -> NDArray[np.intp]:
        first = len(self.radius)
        self._kept += bodies  # an identity is good for as long as its object lives
        self._places |= {id(body): first + index for index, body in enumerate(bodies)}
        self.centre = np.vstack([self.centre, centre])
        self.half = np.vstack([self.half, half])
        self.radius = np.append(self.radius, radius)
        self.inflation = np.append(self.inflation, np.zeros(len(bodies)))
        return np.arange(first, len(self.radius))


class BroadPhase:
    """Lower bounds of the distance that groups have beyond their stop distance.

    Args:
        groups: in any order, none without pairs.
        surroundings: complete already.
    """

    def __init__(self, groups: Sequence[Group], surroundings: Surroundings) -> None:
        self.groups = tuple(groups)
        self._around = surroundings
        counts = [len(group.pairs) for group in groups]
        self._starts = np.cumsum([0, *counts[:-1]], dtype=np.intp)
        pairs = [pair for group in groups for pair in group.pairs]  # a robot may have none to be checked
        self._first = np.array([surroundings.place_of(one) for one, _ in pairs], dtype=np.intp)
        self._second = np.array([surroundings.place_of(other) for _, other in pairs], dtype=np.intp)
        self._touch = surroundings.radius[self._first] + surroundings.radius[self._second]
        self._half = surroundings.half[self._first] + surroundings.half[self._second]
        self._stop = np.array([group.stop_distance_m for group in groups])

    def rooms(self) -> Array:
        """(groups,) lower bounds of least swept distance minus stop distance [m]."""
        around, first, second = self._around, self._first, self._second
        gaps = np.abs(around.centre[first] - around.centre[second]) - self._half
        # of a middle within a box as far as it is from there to the nearest face, the other way
        distances = np.minimum(gaps.max(axis=1, initial=-np.inf), 0.0)
        np.maximum(gaps, 0.0, out=gaps)
        distances += np.sqrt(np.einsum("ij,ij->i", gaps, gaps))
        distances -= self._touch + around.inflation[first] + around.inflation[second]
        least: Array = np.minimum.reduceat(distances, self._starts) - self._stop
        return least


class ScreenedGroups(list[Group]):
    """Groups that are checked together so often that a screen is kept for them; not to be changed.

    Attributes:
        screen: of exactly these groups.
    """

    def __init__(self, groups: Sequence[Group], surroundings: Surroundings) -> None:
        super().__init__(groups)
        self.screen = BroadPhase(groups, surroundings)


class ReferenceProximity(ProximityEngine):
    """All bodies of a cell, placed in spans of joint space and looked at in groups."""

    def __init__(self, cell: CellModel) -> None:
        super().__init__(cell)
        self._spans: dict[str, tuple[Array, Array, Array, Array]] = {}
        self._J: dict[str, Array] = {}
        self._around = Surroundings()
        self._separation = Separation(self.model.nv)
        if cell.structure:
            self._around.add_standing(cell.structure)
            self._separation.add([body.name for body in cell.structure], Extents(cell.structure))
        self._slices = {
            name: self._around.add_moving(bodies.objects, bodies.radii)
            for name, bodies in self._bodies.items()
        }
        self._clones = {
            name: self._around.add_moving(own.clones, self._bodies[name].radii[own.sources])
            for name, own in self._self_groups.items()
        }
        self._places = {
            name: self._separation.add(
                [body.name for body in bodies.objects], bodies.extents, bodies.slice_q, bodies.moved_by
            )
            for name, bodies in self._bodies.items()
        }
        for groups in (*self.alone.values(), *self.between.values()):
            for group in groups:
                self._separation.pair_up([(one.name, other.name) for one, other in group.pairs])
        self.alone = {name: ScreenedGroups(groups, self._around) for name, groups in self.alone.items()}
        self.between = {names: ScreenedGroups(groups, self._around) for names, groups in self.between.items()}

    def place(
        self, robot: str, q: Array, half: Array, offsets: Array | None = None, deviation: Array | None = None
    ) -> float:
        """Place a robot in a span, as `deltaq_cell.compiled_proximity.CompiledProximity.place` does."""
        if offsets is None or deviation is None:
            offsets, deviation = np.zeros((1, q.size)), half
        self._q[self._bodies[robot].slice_q] = q
        self._spans[robot] = q, half, offsets, deviation
        return self._move(robot, q, half)

    def _move(self, robot: str, q: Array, half: Array) -> float:
        greatest = super()._move(robot, q, half)
        bodies, own = self._bodies[robot], self._self_groups[robot]
        J = self._J[robot] = np.reshape(self._data.J, (6, -1))[:, bodies.slice_q].copy()
        corners = bodies.corners_in_world(self._data.oMi)
        rotation = np.array([self._data.oMi[body.parentJoint].rotation for body in bodies.objects])
        axes = np.einsum("bij,bj->bi", rotation, bodies.extents.axis)
        arms = bodies.lever_arms(J, corners) if half.any() else np.zeros(bodies.moved_by.shape)
        self._separation.move(
            self._places[robot], corners, axes, bodies.slice_q, arms, J, half, *self._spans[robot][2:]
        )
        # the middles move with the bodies as their corners do, of which the box was taken in the joints' frames
        local = bodies.extents.corners
        middles = (local.max(axis=1) + local.min(axis=1)) / 2
        placed = [self._data.oMi[body.parentJoint] for body in bodies.objects]
        centres = np.array([pose.act(middle) for pose, middle in zip(placed, middles, strict=True)])
        self._around.centre[self._slices[robot]] = centres
        self._around.inflation[self._slices[robot]] = (arms * half).sum(axis=1)
        self._around.centre[self._clones[robot]] = centres[own.sources]
        self._around.inflation[self._clones[robot]] = own.inflate(arms * half)
        return greatest

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
        return self._J[robot]
