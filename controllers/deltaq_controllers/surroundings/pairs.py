"""Pairs of bodies, compiled: which can be near, which are the nearest, and how the joints change their distance."""

from __future__ import annotations

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.joint_frames import JointTree, placed_joints
from deltaq_controllers.spheres import Spheres, placed
from deltaq_controllers.vectors import cross, distance
from deltaq_protocol.arrays import Array, Indices

_LEAST_RANGE_M = 1e-3
"""Of smaller ranges, or none, no fraction is taken [m]."""

TOUCHING_M = 1e-3
"""Nearest points that are closer give no direction [m]."""


@compiled
def go_to(
    tree: JointTree,
    q: Array,
    spheres: Spheres,
    moving: Indices,
    turned_by: Array,
    q_before: Array,
    centres: Array,
    travel: Array,
) -> Array:
    """Move the `centres` of the `moving` bodies, and add to their `travel` how far they can have gone [m].

    Each travels no farther than its centre, plus its radius times the rotations of all joints that it is `turned_by`.

    Returns:
        (6, m) velocities of what the joints carry, at the world's origin.
    """
    placements, columns = placed_joints(tree, q)
    now, turned = placed(spheres, placements), np.abs(q - q_before)
    for i in range(len(moving)):
        body = moving[i]
        travel[body] += distance(now[i], centres[body]) + spheres.radii[i] * (turned_by[i] * turned).sum()
        centres[body] = now[i]
    return columns


@compiled
def note_distances(
    pairs: Indices, distances: Array, one: Indices, other: Indices, travel: Array, at_least: Array
) -> None:
    """Note distances (k,) of pairs as bounds of them, from where their bodies have travelled to."""
    for k in range(len(pairs)):
        pair = pairs[k]
        at_least[pair] = distances[k] + travel[one[pair]] + travel[other[pair]]


@compiled
def candidates(
    one: Indices,
    other: Indices,
    reported: Indices,
    distances: Array,
    most: int,
    ranges_m: Array,
    travel: Array,
    centres: Array,
    radii: Array,
    at_least: Array,
) -> Indices:
    """Pairs except those of last time that can be among the nearest; bounds from their spheres go to `at_least`.

    Those of last time, at `distances` (k,) now, bound how near a pair has to be to be among the `most` nearest.
    """
    ranges = _ranges_of_nearer(ranges_m, reported, distances, most)
    possible = at_least - travel[one] - travel[other] < ranges
    possible[reported] = False
    near = np.zeros(len(ranges), dtype=np.bool_)
    for pair in np.flatnonzero(possible):
        i, j = one[pair], other[pair]
        gap = distance(centres[i], centres[j]) - radii[i] - radii[j]
        at_least[pair] = max(at_least[pair], gap + travel[i] + travel[j])
        near[pair] = gap < ranges[pair]
    return np.flatnonzero(near)


@compiled
def _ranges_of_nearer(ranges: Array, reported: Indices, distances: Array, most: int) -> Array:
    """(p,) how near a pair has to be to be among the `most` nearest, given the distances (k,) of those found so far."""
    share = 1.0
    if len(reported) == most:
        farthest = 0.0
        for i in range(most):
            farthest = max(farthest, distances[i] / max(ranges[reported[i]], _LEAST_RANGE_M))
        share = min(farthest, 1.0)
    return np.where(ranges > 0.0, share * ranges, ranges)


@compiled
def nearest(ranges: Array, pairs: Indices, distances: Array, most: int) -> Indices:
    """Places of those of `pairs` (k,) in range, the least fraction of their range first, and `most` of them at most."""
    # of two equal pairs the one that is first in the list of all pairs comes first
    order = np.argsort(pairs, kind="mergesort")
    shares = distances / np.maximum(ranges[pairs], _LEAST_RANGE_M)
    nearest = order[np.argsort(shares[order], kind="mergesort")][:most]
    return nearest[distances[nearest] < ranges[pairs[nearest]]]


@compiled
def rows_of(
    pairs: Indices,
    points: Array,
    normals: Array,
    distances: Array,
    columns: Array,
    one: Indices,
    other: Indices,
    moves: Array,
    begin: int,
    end: int,
) -> tuple[Array, Array]:
    """Change of distances by the own joints, (k, n), and by all others, (k, m).

    Args:
        pairs: (k,) the pairs.
        points: (k, 2, 3) nearest points of each [m].
        normals: (k, 3) where it touches coal's normal, first to second body.
        distances: (k,) of these points [m].
        columns: (6, m) velocities of what the joints carry, at the world's origin.
        one: (p,) the first body of each pair.
        other: (p,) the second.
        moves: (bodies, m) 1 where a joint moves a body.
        begin: the first of the own joints.
        end: the joint after the last of them.
    """
    rows = np.zeros((len(pairs), columns.shape[1]))
    for k in range(len(pairs)):
        first, second = moves[one[pairs[k]]], moves[other[pairs[k]]]
        point1, point2 = points[k, 0], points[k, 1]
        away = -normals[k] if distances[k] < TOUCHING_M else (point1 - point2) / distances[k]
        # a force at a point is a wrench at the origin
        moment1, moment2 = cross(point1, away), cross(point2, away)
        for joint in range(columns.shape[1]):
            alike = first[joint] - second[joint]
            for axis in range(3):
                moment = first[joint] * moment1[axis] - second[joint] * moment2[axis]
                rows[k, joint] += (
                    alike * away[axis] * columns[axis, joint] + moment * columns[3 + axis, joint]
                )
    own = rows[:, begin:end].copy()
    rows[:, begin:end] = 0.0
    return own, rows
