"""Planes that keep bodies apart over a whole span of joint space.

A span is `middle + sum_k a_k offset_k + e` with a_k >= 0, sum_k a_k = 1 and |e_j| <= `deviation_j`: the hull of a few
vertices, and what lies a little beside it. Inflating a body by its travel (`deltaq_cell.proximity`) ignores the
direction of its travel. Here n is the normal between the two bodies at the middle, and the gap along n is bounded over
the span:

    n . p(a, e) >= n . p + sum_k a_k n . (J offset_k) - sum_j deviation_j r_j - bend

J is the Jacobian of the point at the middle, so the second term is signed: bodies that slide past one another or part
lose nothing. It is linear in a, so that the gap over a whole body is least at a vertex. r_j is the greatest distance of
a point of the body from the axis of joint j (1 for a prismatic joint), and `bend` bounds the second-order remainder, by
Taylor's theorem with

    |d2p / dq_j dq_k| <= r_k + travel,  k the outer of both; 0 if a prismatic joint is the inner one, or both,

since while the joints move, no point's distance from an axis grows by more than it travels. Both sides of a plane
are extreme points of whole bodies, so nothing rests on n being the best normal.

A fixed plane loses to first order where an edge or a face lies along it and turns. So a plane may turn
with one of the bodies, n(a) = n + sum_k a_k w_k x n with w_k the body's rotation from the middle to a vertex: that
body's side then only shifts, and the other's is as exact as before. The products of two motions add at most the
greatest |w_k x n| times the travel of each body, and n(a) is longer than one by less than half its square.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from deltaq_cell.extents import Extents
from deltaq_protocol.arrays import Array, Flags, Indices

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
