"""Clearance beyond the stop distance, called room, for many configurations at once.

Bodies are taken for capsules, and standing bodies for capsules and boxes: accurate enough for a search, and much
quicker than exact shapes. The results of a search are measured exactly before anything moves
(`deltaq_controllers.advisor`). Of the pairs of a configuration only those are measured that bounds
(`deltaq_controllers.criteria.bounds`) do not rule out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.batch import FrameBatch
from deltaq_controllers.criteria.bounds import ROUNDING_M, CriterionBounds, Standing
from deltaq_controllers.criteria.capsules import box_points, capsule, segment_points
from deltaq_controllers.spheres import local_box
from deltaq_protocol.arrays import Array, Indices

CHUNK = 128
"""Configurations that are measured together: their intermediate arrays stay in the processor's cache."""


@dataclass(frozen=True)
class NearestBodies:
    """The tightest pair of each of N configurations.

    Attributes:
        room: (N,) distance beyond the stop distance [m]; infinite where there is no other body.
        first: (N,) index of the robot's capsule.
        second: (N,) index of the robot's other capsule; -1 for a standing body.
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


_FIELDS = tuple(NearestBodies.__dataclass_fields__)


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
        standing = [body for body in cell.structure if not isinstance(body.geometry, coal.Box)]
        boxes = [body for body in cell.structure if isinstance(body.geometry, coal.Box)]
        stand_middles, stand_halves, stand_radii = _capsules(standing)
        placed = [_box(body) for body in boxes]
        self._standing = Standing(
            stand_middles,
            stand_halves,
            centres=np.array([centre for centre, _, _ in placed]).reshape(-1, 3),
            turns=np.array([turn for _, turn, _ in placed]).reshape(-1, 3, 3),
            sizes=np.array([half for _, _, half in placed]).reshape(-1, 3),
        )

        # room is the distance of the axes less `least`; of two of the robot's own the shorter one comes first
        never = {frozenset(pair) for pair in model.never_checked_pairs()}
        lengths = np.linalg.norm(self._halves, axis=1)
        shorter_first = np.lexsort((np.arange(len(bodies)), lengths)).argsort()
        others = [*bodies, *standing, *boxes]
        other_radii = np.concatenate([radii, stand_radii, np.zeros(len(boxes))])
        self._least = np.full((len(bodies), len(others)), -np.inf)
        for i, body in enumerate(bodies):
            for k, other in enumerate(others):
                if frozenset((body.name, other.name)) in never:
                    continue
                if k >= len(bodies):
                    if self.joints[i] >= 0:
                        self._least[i, k] = radii[i] + other_radii[k] + gate.stop_distance_m
                elif self.joints[i] != self.joints[k] and shorter_first[i] < shorter_first[k]:
                    self._least[i, k] = radii[i] + other_radii[k] + gate.self_stop_distance_m
        self._bounds = CriterionBounds(lengths, self._standing, self._least)

    def nearest(self, frames: FrameBatch, count: int) -> NearestBodies:
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
        return NearestBodies(*(np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS))

    def _nothing(self, count: int) -> NearestBodies:
        index, nowhere = np.zeros(count, dtype=np.intp), np.zeros((count, 3))
        return NearestBodies(np.full(count, np.inf), index, index - 1, nowhere, nowhere, nowhere)

    def _placed(self, frames: FrameBatch, part: slice) -> tuple[Array, Array]:
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

    def _nearest(self, middles: Array, halves: Array) -> NearestBodies:
        count = len(middles)
        if not np.isfinite(self._least).any():
            return self._nothing(count)
        lower, upper = self._bounds.of(middles, halves)
        # only pairs that may be nearer than the likeliest one are measured
        each, likeliest = np.arange(count), lower.argmin(axis=1)
        first = self._measured(middles, halves, each, likeliest)
        bound = np.minimum(upper.min(axis=1), first.room)
        lower[each, likeliest] = np.inf
        rows, pairs = np.nonzero(lower <= bound[:, None] + ROUNDING_M)
        others = self._measured(middles, halves, rows, pairs)
        rows = np.append(each, rows)
        measured = NearestBodies(
            *(np.concatenate([getattr(first, name), getattr(others, name)]) for name in _FIELDS)
        )
        order = np.lexsort((measured.room, rows))
        best = order[np.searchsorted(rows[order], each)]
        return NearestBodies(*(getattr(measured, name)[best] for name in _FIELDS))

    def _measured(self, middles: Array, halves: Array, rows: Indices, pairs: Indices) -> NearestBodies:
        """The given pairs, each of one configuration, exactly."""
        standing, count = self._standing, len(pairs)
        first, other = np.divmod(pairs, self._least.shape[1])
        own, boxed = len(self.joints), len(self.joints) + len(standing.middles)
        on_first, on_second = np.empty((count, 3)), np.empty((count, 3))
        distance, sign = np.empty(count), np.ones(count)

        axes = np.flatnonzero(other < boxed)
        row, i, k = rows[axes], first[axes], other[axes]
        is_own = k < own
        second_middles, second_halves = np.empty((len(axes), 3)), np.empty((len(axes), 3))
        second_middles[is_own] = middles[row[is_own], k[is_own]]
        second_halves[is_own] = halves[row[is_own], k[is_own]]
        second_middles[~is_own] = standing.middles[k[~is_own] - own]
        second_halves[~is_own] = standing.halves[k[~is_own] - own]
        p, r = segment_points(middles[row, i], halves[row, i], second_middles, second_halves)
        on_first[axes], on_second[axes], distance[axes] = p, r, np.linalg.norm(p - r, axis=1)

        beside = np.flatnonzero(other >= boxed)
        if len(beside):
            row, i, box = rows[beside], first[beside], other[beside] - boxed
            centre, R, half = standing.centres[box], standing.turns[box], standing.sizes[box]
            point, on_box, signed = box_points(
                np.einsum("pi,pij->pj", middles[row, i] - centre, R),
                np.einsum("pi,pij->pj", halves[row, i], R),
                half,
            )
            on_first[beside] = np.einsum("pij,pj->pi", R, point) + centre
            on_second[beside] = np.einsum("pij,pj->pi", R, on_box) + centre
            distance[beside], sign[beside] = signed, np.where(signed < 0.0, -1.0, 1.0)

        away = (sign / np.maximum(np.abs(distance), 1e-12))[:, None] * (on_first - on_second)
        room = distance - self._least[first, other]
        return NearestBodies(room, first, np.where(other < own, other, -1), on_first, on_second, away)


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
