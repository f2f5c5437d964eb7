"""Room between bodies, for many configurations at once.

Bodies are taken for capsules and what stands about for capsules and boxes: near enough to search with, and much quicker
than exact shapes. What a search finds is measured exactly before anybody moves (`deltaq_controllers.advisor`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.batch import Frames
from deltaq_controllers.criteria.capsules import box_distance, box_points, capsule, segment_points
from deltaq_controllers.spheres import local_box

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CHUNK = 128
"""Configurations that are measured together: their intermediate arrays stay in the processor's cache."""

_ROUNDING_M = 1e-6
_TINY = 1e-12


@dataclass(frozen=True)
class Nearest:
    """The tightest pair of each of N configurations.

    Attributes:
        room: (N,) distance beyond the stop distance [m]; infinite where there is nothing to be near to.
        first: (N,) index of the robot's capsule.
        second: (N,) index of the robot's other capsule; -1 where it is something that stands.
        on_first: (N, 3) the nearest point on the first one's axis, in the world [m].
        on_second: (N, 3) the nearest point on the other's axis, or on the box [m].
        away: (N, 3) unit vector along which the first point gains room.
    """

    room: Array
    first: Indices
    second: Indices
    on_first: Array
    on_second: Array
    away: Array


_FIELDS = tuple(Nearest.__dataclass_fields__)


class ClearanceField:
    """Capsules of one robot against each other and against the structure.

    Args:
        cell: model of the cell.
        robot: name of the robot.

    Attributes:
        joints: (c,) which joint carries each capsule; -1 stands still.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        gate, model = cell.description.gate, cell.robots[robot]
        bodies = list(model.geometry.geometryObjects)
        self.joints = np.array([int(body.parentJoint) - 1 for body in bodies], dtype=np.intp)
        self._carried = [
            (int(joint), np.flatnonzero(self.joints == joint)) for joint in np.unique(self.joints)
        ]
        self._middles, self._halves, radii = _capsules(bodies)
        lengths = np.linalg.norm(self._halves, axis=1)
        never = {frozenset(pair) for pair in model.never_checked_pairs()}

        def pairs(others: list[Any], own: bool) -> Indices:
            found = [
                (i, j)
                for i, body in enumerate(bodies)
                for j, other in enumerate(bodies[:i] if own else others)
                if (self.joints[i] != self.joints[j] if own else self.joints[i] >= 0)
                and frozenset((body.name, other.name)) not in never
            ]
            return np.array(found, dtype=np.intp).reshape(-1, 2).T

        standing = [body for body in cell.structure if not isinstance(body.geometry, coal.Box)]
        boxes = [body for body in cell.structure if isinstance(body.geometry, coal.Box)]
        self._stand_middles, self._stand_halves, stand_radii = _capsules(standing)
        placed = [_box(body) for body in boxes]
        self._centres = np.array([centre for centre, _, _ in placed]).reshape(-1, 3)
        self._turns = np.array([turn for _, turn, _ in placed]).reshape(-1, 3, 3)
        self._sizes = np.array([half for _, _, half in placed]).reshape(-1, 3)
        own, against, boxed = pairs([], own=True), pairs(standing, own=False), pairs(boxes, own=False)
        boxed = boxed[:, np.argsort(boxed[1], kind="stable")]  # box by box
        self._own, self._against, self._boxed = own, against, boxed
        # room is the distance of the axes less `least`
        self._least = np.concatenate(
            [
                radii[own[0]] + radii[own[1]] + gate.self_stop_distance_m,
                radii[against[0]] + stand_radii[against[1]] + gate.stop_distance_m,
                radii[boxed[0]] + gate.stop_distance_m,
            ]
        )
        # first the shorter one's middle is looked at; its axis can be nearer by `slack`
        stand_lengths = np.linalg.norm(self._stand_halves, axis=1)
        self._own_shorter = np.where(lengths[own[0]] <= lengths[own[1]], own, own[::-1])
        self._is_shorter = lengths[against[0]] <= stand_lengths[against[1]]
        self._slack = np.concatenate(
            [
                lengths[self._own_shorter[0]],
                np.minimum(lengths[against[0]], stand_lengths[against[1]]),
                lengths[boxed[0]],
            ]
        )

    def nearest(self, frames: Frames, count: int) -> Nearest:
        """The tightest pair of each configuration.

        Args:
            frames: all joints placed.
            count: N.
        """
        parts = [
            self._nearest(*self._placed(frames, slice(start, min(start + CHUNK, count))))
            for start in range(0, count, CHUNK)
        ]
        if len(parts) == 1:
            return parts[0]
        if not parts:
            return self._nothing(0)
        return Nearest(*(np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS))

    def _nothing(self, count: int) -> Nearest:
        index, nowhere = np.zeros(count, dtype=np.intp), np.zeros((count, 3))
        return Nearest(np.full(count, np.inf), index, index - 1, nowhere, nowhere, nowhere)

    def _placed(self, frames: Frames, part: slice) -> tuple[Array, Array]:
        """(N, c, 3) middles and halves of the capsules in the world."""
        count = part.stop - part.start
        middles, halves = np.empty((count, len(self.joints), 3)), np.empty((count, len(self.joints), 3))
        for joint, which in self._carried:
            if joint < 0:
                middles[:, which], halves[:, which] = self._middles[which], self._halves[which]
                continue
            turn = frames.rotation[joint][part].transpose(0, 2, 1)
            middles[:, which] = self._middles[which] @ turn + frames.position[joint][part, None]
            halves[:, which] = self._halves[which] @ turn
        return middles, halves

    def _nearest(self, middles: Array, halves: Array) -> Nearest:
        count = len(middles)
        if not len(self._least):
            return self._nothing(count)
        upper = self._middle_distances(middles, halves) - self._least
        lower = upper - self._slack
        # only pairs that may be nearer than the likeliest one are measured
        each, likeliest = np.arange(count), lower.argmin(axis=1)
        first = self._measured(middles, halves, each, likeliest)
        bound = np.minimum(upper.min(axis=1), first.room)
        lower[each, likeliest] = np.inf
        rows, pairs = np.nonzero(lower <= bound[:, None] + _ROUNDING_M)
        others = self._measured(middles, halves, rows, pairs)
        rows = np.append(each, rows)
        measured = Nearest(
            *(np.concatenate([getattr(first, name), getattr(others, name)]) for name in _FIELDS)
        )
        order = np.lexsort((measured.room, rows))
        best = order[np.searchsorted(rows[order], each)]
        return Nearest(*(getattr(measured, name)[best] for name in _FIELDS))

    def _middle_distances(self, middles: Array, halves: Array) -> Array:
        """(N, pairs) distances of the shorter one's middle from the longer one's axis, or from a box."""
        standing = self._stand_middles, self._stand_halves
        i, j = self._own_shorter
        own = _from_axes(middles, middles, halves)[:, i, j]
        i, j = self._against
        against = np.where(
            self._is_shorter,
            _from_axes(middles, *standing)[:, i, j],
            _from_axes(self._stand_middles, middles, halves)[:, j, i],
        )
        distances = [np.sqrt(np.maximum(np.concatenate([own, against], axis=1), 0.0))]
        for box, (centre, R, half) in enumerate(zip(self._centres, self._turns, self._sizes, strict=True)):
            which = self._boxed[0][self._boxed[1] == box]
            distances.append(box_distance((middles[:, which] - centre) @ R, half))
        return np.concatenate(distances, axis=1)

    def _measured(self, middles: Array, halves: Array, rows: Indices, pairs: Indices) -> Nearest:
        """The pairs asked for, each of one configuration, exactly."""
        owns, againsts = len(self._own[0]), len(self._against[0])
        first, second = np.empty_like(pairs), np.full_like(pairs, -1)
        on_first, on_second = np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3))
        distance, sign = np.zeros(len(pairs)), np.ones(len(pairs))

        kind = np.flatnonzero(pairs < owns)
        i, j = self._own[:, pairs[kind]]
        first[kind], second[kind], row = i, j, rows[kind]
        on_first[kind], on_second[kind] = segment_points(
            middles[row, i], halves[row, i], middles[row, j], halves[row, j]
        )

        kind = np.flatnonzero((pairs >= owns) & (pairs < owns + againsts))
        i, j = self._against[:, pairs[kind] - owns]
        first[kind], row = i, rows[kind]
        on_first[kind], on_second[kind] = segment_points(
            middles[row, i], halves[row, i], self._stand_middles[j], self._stand_halves[j]
        )
        distance[:] = np.linalg.norm(on_first - on_second, axis=1)

        kind = np.flatnonzero(pairs >= owns + againsts)
        if len(kind):
            i, box = self._boxed[:, pairs[kind] - owns - againsts]
            first[kind], row = i, rows[kind]
            centre, R, half = self._centres[box], self._turns[box], self._sizes[box]
            point, on_box, signed = box_points(
                np.einsum("pi,pij->pj", middles[row, i] - centre, R),
                np.einsum("pi,pij->pj", halves[row, i], R),
                half,
            )
            on_first[kind] = np.einsum("pij,pj->pi", R, point) + centre
            on_second[kind] = np.einsum("pij,pj->pi", R, on_box) + centre
            distance[kind], sign[kind] = signed, np.where(signed < 0.0, -1.0, 1.0)

        away = sign[:, None] * (on_first - on_second)
        away /= np.maximum(np.abs(distance), 1e-12)[:, None]
        return Nearest(distance - self._least[pairs], first, second, on_first, on_second, away)


def _from_axes(points: Array, middles: Array, halves: Array) -> Array:
    """(..., a, b) squared distances of points (..., a, 3) from axes with middles and halves (..., b, 3)."""
    turned = np.swapaxes(middles, -1, -2), np.swapaxes(halves, -1, -2)
    apart = (points * points).sum(axis=-1)[..., :, None] - 2.0 * (points @ turned[0])
    apart = apart + (middles * middles).sum(axis=-1)[..., None, :]
    along = points @ turned[1] - (middles * halves).sum(axis=-1)[..., None, :]
    length = (halves * halves).sum(axis=-1)[..., None, :]
    share = np.clip(along / np.maximum(length, _TINY), -1.0, 1.0)
    squared: Array = apart + share * (share * length - 2.0 * along)
    return squared


def _capsules(bodies: list[Any]) -> tuple[Array, Array, Array]:
    found = [capsule(body) for body in bodies]
    middles = np.array([middle for middle, _, _ in found]).reshape(-1, 3)
    halves = np.array([half for _, half, _ in found]).reshape(-1, 3)
    return middles, halves, np.array([radius for _, _, radius in found])


def _box(body: Any) -> tuple[Array, Array, Array]:
    """Centre, rotation and half of the size of a box in the world."""
    low, high = local_box(body)
    return (
        np.array(body.placement.act(0.5 * (low + high))),
        body.placement.rotation.copy(),
        0.5 * (high - low),
    )
