"""Convex hulls whose distances do not depend on earlier queries.

coal searches for the farthest corner of a large hull from where its last search ended, so a distance depends, in
its last digits, on the queries before it, and a recording would not replay to the bit. Up to 32 corners it checks
all of them. A mesh whose hull has more is replaced by a polytope of at most 32 corners around it.

A hull is sent as its corners. The same corners in the same order give the same distances to the last bit. Hulls that
come with a robot may have more corners, and then do so but for rounding: see `deltaq_cell.convex_parts`.
"""

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any, TypeAlias

import coal
import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

Corners: TypeAlias = tuple[tuple[float, float, float], ...]
"""Corners of a hull in the frame of its body [m]."""

MOST_CORNERS = 32
"""coal's bound between searching all corners and walking from one to the next."""

MOST_TOLD = 256
"""Most corners of a hull that came with a robot."""

MOST_M = 1e6
"""Greatest coordinate of a corner [m]."""

_FLAT = 1e-6
"""Points that spread across a plane by less than this fraction of their spread within it are taken to lie in it."""

_CLOSE = 1e-6
"""A polytope that reaches beyond its points by no more than this fraction of their size needs no further face."""

_ROOM = 2e-9
"""Faces are moved out by this fraction of the size, more than rounding takes away."""


class HullError(DeltaqError):
    """Points that no convex hull with a volume can be made of."""


def hull_corners(points: Array) -> Corners:
    """Corners of the convex hull of (k, 3) `points`, or of a polytope of at most 32 corners around it.

    Raises:
        HullError: the points lie in a plane, or some are not finite.
    """
    try:
        hull = convex_hull(points)
    except RuntimeError:  # coal takes no corner with more than 255 neighbours, such as a fine cone's tip
        return as_told(_outside(_around(points, DIRECTIONS)))
    corners = points_of(hull)
    return as_told(corners if len(corners) <= MOST_CORNERS else _outside(_around(corners, _normals_of(hull))))


def hull_shape(corners: Corners) -> Any:
    """The `coal.Convex` with these corners, in this order.

    Raises:
        HullError: there are more than `MOST_TOLD`, or they are not the corners of a convex body.
    """
    if len(corners) > MOST_TOLD:
        raise HullError(f"a hull has {len(corners)} corners, must have at most {MOST_TOLD}")
    hull = convex_hull(np.array(corners, dtype=np.float64).reshape(-1, 3))
    if hull.num_points != len(corners):
        raise HullError(f"of {len(corners)} corners of a hull only {hull.num_points} are on its outside")
    order = {corner: index for index, corner in enumerate(corners)}
    numbers = [order[corner] for corner in as_told(points_of(hull))]
    faces = coal.StdVec_Triangle()
    for face in faces_of(hull):
        faces.append(coal.Triangle(*(numbers[corner] for corner in face)))
    return coal.Convex(_points(corners), faces)


def _around(points: Array, normals: Array) -> Array:
    """(m, 3) corners, m <= 32, of a polytope that holds all (k, 3) `points`.

    It begins as a box, and is cut where it reaches farthest beyond the points, as long as the corners allow.

    Args:
        points: to be contained.
        normals: (n, 3) outward ones of their hull, which cut best.
    """
    directions = np.vstack([DIRECTIONS, normals])
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    size = float(np.ptp(points, axis=0).max())
    reach = (((points - middle) / size) @ directions.T).max(axis=0) + _ROOM
    faces = list(range(_BOX_FACES))
    corners = _corners(directions[faces], reach[faces])
    while True:
        beyond = (corners @ directions.T).max(axis=0) - reach
        faces.append(int(np.argmax(beyond)))
        cut = _corners(directions[faces], reach[faces])
        if len(cut) > MOST_CORNERS or beyond.max() < _CLOSE:
            found: Array = corners * size + middle
            return found
        corners = cut


def _outside(corners: Array) -> Array:
    """The corners that qhull keeps; of two that differ only by rounding it keeps one."""
    hull = convex_hull(corners)
    return corners if hull.num_points == len(corners) else points_of(hull)


def _corners(normals: Array, reach: Array) -> Array:
    """(m, 3) corners of the polytope of all x with `normals @ x <= reach`."""
    triples = np.array(list(combinations(range(len(normals)), 3)))
    meets = np.abs(np.linalg.det(normals[triples])) > 1e-6
    points = np.linalg.solve(normals[triples[meets]], reach[triples[meets]][..., None])[..., 0]
    inside = np.all(points @ normals.T <= reach + 1e-10, axis=1)
    corners: Array = np.unique(np.round(points[inside], 9) + 0.0, axis=0)
    return corners


def _directions() -> Array:
    box = [sign * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]
    steps = (-1.0, -0.5, 0.0, 0.5, 1.0)
    others = [
        step for step in product(steps, repeat=3) if max(map(abs, step)) == 1 and np.count_nonzero(step) > 1
    ]
    normals = np.array([*box, *others])
    unit: Array = normals / np.linalg.norm(normals, axis=1)[:, None]
    return unit


_BOX_FACES = 6
DIRECTIONS = _directions()
"""A box's normals first, then those that cut its edges and corners."""


def convex_hull(points: Array) -> Any:
    """The `coal.Convex` of (k, 3) `points` [m].

    Raises:
        HullError: the points lie in a plane, or some are not finite.
        RuntimeError: a corner has more than 255 neighbours.
    """
    if len(points) < 4 or not np.all(np.abs(points) <= MOST_M):
        raise HullError(f"no convex hull of {len(points)} points: it takes four, and finite numbers")
    greatest, _, least = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if least <= _FLAT * greatest:  # checked first, since qhull crashes on it
        raise HullError(
            f"no convex hull of {len(points)} points that lie in a plane; give the body a thickness"
        )
    return coal.Convex.convexHull(_points(points), True, "Qt")


def points_of(hull: Any) -> Array:
    """(k, 3) corners of a hull [m]."""
    return np.array([hull.point(index) for index in range(hull.num_points)])


def faces_of(hull: Any) -> list[list[int]]:
    """Triangles of a hull, each as numbers of its corners."""
    return [[hull.polygons(face)[corner] for corner in range(3)] for face in range(hull.num_polygons)]


def _normals_of(hull: Any) -> Array:
    """(n, 3) outward unit normals of a hull's faces, nearly equal ones once."""
    corners = points_of(hull)
    a, b, c = corners[np.array(faces_of(hull))].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    outward = np.sign(np.einsum("ij,ij->i", normals, a - corners.mean(axis=0)))
    kept = length > 1e-9 * length.max()
    normals = normals[kept] * (outward[kept] / length[kept])[:, None]
    distinct = np.unique(np.round(normals, 2), axis=0)
    unit: Array = distinct / np.linalg.norm(distinct, axis=1)[:, None]
    return unit


def _points(points: Array | Corners) -> Any:
    vector = coal.StdVec_Vec3s()
    for point in points:
        vector.append(np.array(point, dtype=np.float64))
    return vector


def as_told(points: Array | Sequence[Any]) -> Corners:
    """Corners in the form of messages."""
    return tuple((float(x), float(y), float(z)) for x, y, z in points)
