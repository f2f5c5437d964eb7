"""Convex hulls that measure alike whatever was measured before.

coal looks for the farthest corner of a large hull from where its last search ended, so a distance depends, in
its last digits, on the queries before it, and a recording would not replay to the bit. Up to 32 corners it looks
at all of them. Hulls with more are replaced by a polytope of 14 faces around them.
"""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_CORNERS = 32
"""coal's bound between searching all corners and walking from one to the next."""

_CUBE = [sign * axis for sign in (-1.0, 1.0) for axis in np.eye(3)]
_OCTAHEDRON = [np.array(signs) / np.sqrt(3.0) for signs in product((-1.0, 1.0), repeat=3)]
_FACES = np.array([*_CUBE, *_OCTAHEDRON])
"""Outward normals: of a cube, and of an octahedron that cuts its corners off."""


def reproducible_hull(hull: Any) -> Any:
    """The same hull if it is small, else one around it of at most 24 corners.

    Args:
        hull: `coal.Convex`.
    """
    corners = np.array([hull.point(index) for index in range(hull.num_points)])
    if len(corners) <= MOST_CORNERS:
        return hull
    points = coal.StdVec_Vec3s()
    for corner in around(corners):
        points.append(corner)
    return coal.Convex.convexHull(points, True, "Qt")


def around(points: Array) -> Array:
    """(m, 3) corners, m <= 24, of the smallest polytope with these 14 faces that holds (k, 3) `points`."""
    offsets = (points @ _FACES.T).max(axis=0)
    triples = np.array(list(combinations(range(len(_FACES)), 3)))
    normals = _FACES[triples]
    meets = np.abs(np.linalg.det(normals)) > 1e-9
    corners = np.linalg.solve(normals[meets], offsets[triples[meets]][..., None])[..., 0]
    size = float(np.ptp(points, axis=0).max())
    inside = np.all(corners @ _FACES.T <= offsets + 1e-9 * size, axis=1)
    kept: Array = np.unique(np.round(corners[inside] / size, 9), axis=0) * size
    return kept
