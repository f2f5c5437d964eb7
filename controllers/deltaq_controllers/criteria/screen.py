"""Which pairs of bodies can be near, and so have to be measured with exact shapes.

A body is enclosed in a capsule, a box that stands still is a box, and their distance is never more than that of the
bodies. Compiled, because a path is a thousand configurations of a thousand pairs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import coal
import numpy as np

from deltaq_cell.compiled import compiled, inlined
from deltaq_cell.composite_model import WORLD
from deltaq_cell.extents import corners_of
from deltaq_controllers.spheres import local_box
from deltaq_protocol.arrays import Array, Flags, Indices

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
