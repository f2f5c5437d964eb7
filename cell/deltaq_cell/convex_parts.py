"""A mesh as a few convex parts that together contain it, each closer to it than `deltaq_cell.hull` makes one hull.

A bent link is far from its convex hull. It is cut by planes where that takes away most volume. Each triangle is cut
where it crosses a plane, and each part is the hull of the pieces on its side, so every point of the surface is in a
part. So is every point within a closed surface: a part is cut across two axes at most, and a line along the third
through a point of the part meets the surface on both sides of it, within the part.

A hull keeps all its corners up to a bound, and one with more gets a polytope around it that is closer than a cell's:
the kernel takes any number of corners, and only the last digits of what coal measures depend on earlier queries.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from deltaq_cell.hull import DIRECTIONS, Corners, HullError, as_told, convex_hull, faces_of, points_of
from deltaq_cell.kernel.arrays import Integers
from deltaq_protocol.arrays import Array

MOST_PARTS = 4
"""Of one mesh: further cuts take away little, and each part takes time in every decision."""

LEAST_GAIN = 0.06
"""A cut has to take away this share of the volume of the mesh's hull."""

MOST_CORNERS = 160
"""Of one part."""

WITHIN_M = 3e-4
"""A polytope with fewer corners than its points goes beyond them by about as much, if the corners suffice [m]."""

_CUTS = (0.18, 0.34, 0.5, 0.66, 0.82)
"""Candidates for planes, as shares of a part's length; of the best one its neighbours are tried, too."""

_BESIDE = (-0.08, 0.08)

_LOOKED_AT = 1500
"""Triangles of a mesh at which candidates are compared."""


def convex_parts(triangles: Array) -> list[Corners]:
    """Corners of convex bodies that together contain a mesh [m].

    Args:
        triangles: (n, 3, 3) corners of the mesh's triangles [m].

    Raises:
        HullError: the mesh lies in a plane, or a number is not finite.
    """
    return list(_parts_of(np.ascontiguousarray(triangles, dtype=np.float64).tobytes()))


@lru_cache(maxsize=64)
def _parts_of(mesh: bytes) -> tuple[Corners, ...]:
    triangles = np.frombuffer(mesh).reshape(-1, 3, 3)
    whole = close_hull(triangles.reshape(-1, 3))
    a, b, c = (triangles - triangles.mean(axis=(0, 1))).transpose(1, 0, 2)
    inside_m3 = abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6
    if inside_m3 > (1.0 - LEAST_GAIN) * _volume_m3(triangles):
        return (whole,)
    principal = np.linalg.svd(np.array(whole) - np.mean(whole, axis=0), full_matrices=False)[2]
    found = [split(triangles, axes) for axes in (np.eye(3), principal)]
    pieces = min(found, key=lambda parts: sum(map(_volume_m3, parts)))
    try:
        return tuple(close_hull(part.reshape(-1, 3)) for part in pieces) if len(pieces) > 1 else (whole,)
    except HullError:  # a piece of an open mesh is flat
        return (whole,)


def close_hull(points: Array) -> Corners:
    """Corners of the convex hull of (k, 3) `points`, or of a polytope of at most `MOST_CORNERS` around it [m].

    Raises:
        HullError: the points lie in a plane, or some are not finite.
    """
    try:
        hull = points_of(convex_hull(points))
    except RuntimeError:  # coal takes no corner with more than 255 neighbours
        hull = np.unique(points, axis=0)
    corners = hull if len(hull) <= MOST_CORNERS else _around(hull)
    while len(again := points_of(convex_hull(corners))) < len(corners):
        corners = again  # without those that are in a face but for rounding
    return as_told(corners)


def _around(hull: Array) -> Array:
    """(m, 3) corners, m <= `MOST_CORNERS`, of a polytope that holds all (k, 3) points of `hull`.

    It begins within them, gets the points that are farthest beyond its faces, and is then pushed out.
    """
    corners = hull[np.unique((hull @ DIRECTIONS.T).argmax(axis=0))]
    while True:
        corners, _, normals, reach = _faced(corners)
        beyond = hull @ normals.T - reach
        depth, far = beyond.max(axis=0), beyond.argmax(axis=0)
        free = MOST_CORNERS - len(corners)
        if depth.max() <= WITHIN_M or free <= 0:
            break
        deepest = np.argsort(-depth)[: max(1, free // 4)]
        added = np.unique(far[deepest[depth[deepest] > max(WITHIN_M, depth.max() / 2)]])
        corners = np.vstack([corners, hull[added]])
    for _ in range(60):
        corners, faces, normals, reach = _faced(corners)
        beyond = np.maximum((hull @ normals.T).max(axis=0) - reach, 0.0)
        if beyond.max() < 1e-8:
            break
        push, along = np.zeros(len(corners)), np.zeros_like(corners)
        np.maximum.at(push, faces.ravel(), np.repeat(beyond, 3))
        np.add.at(along, faces.ravel(), np.repeat(normals * beyond[:, None], 3, axis=0))
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-30)
        corners = corners + along * (0.6 * push / length)[:, None]
    # whatever is left beyond a face, the same body a little larger has it
    corners, _, normals, reach = _faced(corners)
    middle = corners.mean(axis=0)
    larger = (((hull - middle) @ normals.T).max(axis=0) / (reach - normals @ middle)).max() + 1e-9
    grown: Array = middle + max(1.0, larger) * (corners - middle)
    return grown


def _faced(points: Array) -> tuple[Array, Integers, Array, Array]:
    """Corners (m, 3) of a hull, its triangles (f, 3), their outward unit normals (f, 3), and how far along (f,)."""
    hull = convex_hull(points)
    corners, faces = points_of(hull), np.array(faces_of(hull))
    a, b, c = corners[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    kept = length > 1e-9 * length.max()
    faces, normals, a = faces[kept], normals[kept] / length[kept][:, None], a[kept]
    outward = np.where(np.einsum("ij,ij->i", normals, a - corners.mean(axis=0)) < 0.0, -1.0, 1.0)
    normals = normals * outward[:, None]
    return corners, faces, normals, np.einsum("ij,ij->i", normals, a)


@dataclass(frozen=True)
class _Cut:
    """The best plane through a part, `axes[axis] @ x = at`, and the volume that it takes away."""

    gain_m3: float = 0.0
    axis: int = 0
    at: float = 0.0


def split(triangles: Array, axes: Array) -> list[Array]:
    """Pieces of a mesh, each (k, 3, 3) triangles, cut across two of the `axes` (3, 3) at most [m]."""
    parts: list[tuple[Array, frozenset[int], _Cut]] = [
        (triangles, frozenset(), _best(triangles, axes, frozenset()))
    ]
    least_m3 = LEAST_GAIN * _volume_m3(triangles)
    while len(parts) < MOST_PARTS:
        number = max(range(len(parts)), key=lambda index: parts[index][2].gain_m3)
        part, across, cut = parts[number]
        if not cut.gain_m3 > least_m3:
            break
        across |= {cut.axis}
        sides = clipped(part, axes[cut.axis], cut.at)
        parts[number : number + 1] = [(side, across, _best(side, axes, across)) for side in sides]
    return [part for part, *_ in parts]


def _best(triangles: Array, axes: Array, across: frozenset[int]) -> _Cut:
    """The plane that takes away most volume, of those across an axis by which a part may be cut."""
    looked_at = triangles[:: len(triangles) // _LOOKED_AT + 1]
    whole = _volume_m3(looked_at)
    along = looked_at @ axes.T
    low, length = along.min(axis=(0, 1)), np.ptp(along, axis=(0, 1))

    def gain_m3(cut: tuple[int, float]) -> float:
        axis, share = cut
        sides = clipped(looked_at, axes[axis], low[axis] + share * length[axis])
        gain = whole - sum(map(_volume_m3, sides))
        return gain if np.isfinite(gain) else 0.0

    coarse = [(axis, share) for axis in (across if len(across) == 2 else range(3)) for share in _CUTS]
    best = max(coarse, key=gain_m3)
    axis, share = max([best, *((best[0], best[1] + beside) for beside in _BESIDE)], key=gain_m3)
    return _Cut(gain_m3((axis, share)), axis, float(low[axis] + share * length[axis]))


def clipped(triangles: Array, normal: Array, at: float) -> tuple[Array, Array]:
    """The triangles below and above the plane `normal @ x = at`; one that crosses it is cut in three."""
    off = triangles @ normal - at
    below, above = (off <= 0.0).all(axis=1), (off >= 0.0).all(axis=1)
    crossing = ~below & ~above
    corners, off = triangles[crossing], off[crossing]
    # the corner that is alone on its side comes first
    is_above = off > 0.0
    tip_above = is_above.sum(axis=1) == 1
    alone = np.where(tip_above, is_above.argmax(axis=1), is_above.argmin(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[:, :, None], axis=1).transpose(1, 0, 2)
    d, e, f = np.take_along_axis(off, order, axis=1).T[:, :, None]
    ab, ac = a + d / (d - e) * (b - a), a + d / (d - f) * (c - a)
    tip = np.stack([a, ab, ac], axis=1)
    rest = np.stack([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
    return (
        np.concatenate([triangles[below], tip[~tip_above], *rest[:, tip_above]]),
        np.concatenate([triangles[above & ~below], tip[tip_above], *rest[:, ~tip_above]]),
    )


def _volume_m3(triangles: Array) -> float:
    """Volume of a hull, by the corners that are farthest along some directions; infinite for a flat one."""
    points = triangles.reshape(-1, 3)
    if not len(points):
        return np.inf
    try:
        return float(convex_hull(points[np.unique((DIRECTIONS @ points.T).argmax(axis=1))]).computeVolume())
    except HullError:
        return np.inf
