"""The kernel's screen by tight boxes: a bound from below of the distance of two bodies, and the way it was found.

Of any unit vector n, what two boxes leave free between them along n is no more than the distance of the bodies in
them. Tried are the normals of the boxes' faces.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined
from deltaq_cell.kernel.arrays import Anatomy, Placed


@inlined
def apart(cell: Anatomy, placed: Placed, first: int, second: int) -> tuple[float, float, float, float]:
    """Bound from below of the distance of two bodies [m], and a unit vector from first to second."""
    here, there = placed.box_centre[first], placed.box_centre[second]
    x, y, z = there[0] - here[0], there[1] - here[1], there[2] - here[2]
    best, nx, ny, nz = -math.inf, 0.0, 0.0, 1.0
    for face in range(6):
        edge = placed.edges[first, face] if face < 3 else placed.edges[second, face - 3]
        ex, ey, ez = edge[0], edge[1], edge[2]
        along = ex * x + ey * y + ez * z
        free = abs(along)
        for k in range(3):
            one, other = placed.edges[first, k], placed.edges[second, k]
            free -= cell.half_edges[first, k] * abs(ex * one[0] + ey * one[1] + ez * one[2])
            free -= cell.half_edges[second, k] * abs(ex * other[0] + ey * other[1] + ez * other[2])
        if free > best:
            best, nx, ny, nz = free, ex, ey, ez
            if along < 0.0:
                nx, ny, nz = -ex, -ey, -ez
    return best, nx, ny, nz
