"""Pairs of bodies, compiled: which can be near, which are the nearest, and how the joints change their distance."""

from __future__ import annotations

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.spheres import Spheres, placed
from deltaq_controllers.vectors import cross, distance
from deltaq_protocol.arrays import Array, Indices

_LEAST_RANGE_M = 1e-3
"""Of smaller ranges, or none, no fraction is taken [m]."""

TOUCHING_M = 1e-3
"""Nearest points that are closer give no direction [m]."""


@compiled
def note_travel(
    spheres: Spheres,
    placements: Array,
    moving: Indices,
    turned_by: Array,
    turned: Array,
    centres: Array,
    travel: Array,
) -> None:
    """Move the `centres` of the `moving` bodies, and add to their `travel` how far they can have gone [m].

    Each travels no farther than its centre, plus its radius times the rotations of all joints that it is `turned_by`.
    """
    now = placed(spheres, placements)
    for i in range(len(moving)):
        body = moving[i]
        travel[body] += distance(now[i], centres[body]) + spheres.radii[i] * (turned_by[i] * turned).sum()
        centres[body] = now[i]


@compiled
def candidates(
    one: Indices,
    other: Indices,
    reported: Indices,
    ranges: Array,
    travel: Array,
    centres: Array,
    radii: Array,
    at_least: Array,
) -> Indices:
    """Pairs except those of last time that can be within (p,) ranges; bounds from their spheres go to `at_least`."""
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
def ranges_of_nearer(ranges: Array, reported: Indices, distances: Array, most: int) -> Array:
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
    contacts: Array, distances: Array, columns: Array, first: Array, second: Array, begin: int, end: int
) -> tuple[Array, Array]:
    """Change of distances by the own joints, (k, n), and by all others, (k, m).

    Args:
        contacts: (k, 3, 3) nearest points of each pair and, where it touches, coal's normal, first to second body.
        distances: (k,) of these points [m].
        columns: (6, m) velocities of what the joints carry, at the world's origin.
        first: (k, m) 1 where a joint moves the first body.
        second: (k, m) 1 where a joint moves the second.
        begin: the first of the own joints.
        end: the joint after the last of them.
    """
    rows = np.zeros((len(contacts), columns.shape[1]))
    for k in range(len(contacts)):
        point1, point2 = contacts[k, 0], contacts[k, 1]
        away = -contacts[k, 2] if distances[k] < TOUCHING_M else (point1 - point2) / distances[k]
        # a force at a point is a wrench at the origin
        moment1, moment2 = cross(point1, away), cross(point2, away)
        for joint in range(columns.shape[1]):
            alike = first[k, joint] - second[k, joint]
            for axis in range(3):
                moment = first[k, joint] * moment1[axis] - second[k, joint] * moment2[axis]
                rows[k, joint] += (
                    alike * away[axis] * columns[axis, joint] + moment * columns[3 + axis, joint]
                )
    own = rows[:, begin:end].copy()
    rows[:, begin:end] = 0.0
    return own, rows
