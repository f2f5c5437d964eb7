"""Bounds of distances, from below and from above, each with a simple proof.

From below by a plane: for any unit vector n, the gap between two bodies along n is at most their distance. From above
by two points, one of each body. The search for the best plane is that of Gilbert, Johnson and Keerthi (1988, IEEE J.
Robotics and Automation 4(2)), but neither bound depends on its success: a failed search leaves the bounds far apart,
and a lower bound that is too small never hides a near pair.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined
from deltaq_cell.kernel.arrays import Anatomy, Placed, PlacedBody
from deltaq_protocol.arrays import Array

ROUNDING_M = 1e-9
"""Taken off every bound from below, and added to every one from above: a million times what arithmetic may be off."""

_ITERATIONS = 40
"""Steps of one search; flat bodies take four to eight, round ones twice as many."""

_CLOSED_M = 1e-7
"""A search ends where its bounds are as near to one another as this."""

_SHARE = 0.01
"""Or where they are as near as this share of the room that is left, which the plane found may lose."""


@inlined
def body_at(cell: Anatomy, placed: Placed, number: int) -> PlacedBody:
    """A body at its placement."""
    axis = placed.axis[number]
    return PlacedBody(
        placed.corners[number],
        cell.corner_count[number],
        axis[0],
        axis[1],
        axis[2],
        cell.disc[number],
        cell.ball[number],
    )


@inlined
def gap(
    first: PlacedBody,
    second: PlacedBody,
    x: float,
    y: float,
    z: float,
    enough_m: float,
    asked_m: float,
    simplex: Array,
) -> tuple[float, float, float, float, float]:
    """Bounds of the distance of two bodies [m], and a normal n from first to second.

    Args:
        first: one body.
        second: the other.
        x: with y and z a direction from first to second to begin with, of any length.
        y: likewise.
        z: likewise.
        enough_m: the search ends where a lower bound exceeds it.
        asked_m: distance beyond which the bodies have room, of which a hundredth may be lost; infinite if none may.
        simplex: (4, 3), is written to.

    Returns:
        Lower bound, upper bound, and the three parts of n; the upper one is infinite if the search ended early,
        and zero but for rounding where bodies overlap.
    """
    balls = first.ball + second.ball
    enough_m += balls + ROUNDING_M
    asked_m += balls
    lower, upper, nx, ny, nz = -math.inf, math.inf, 0.0, 0.0, 1.0
    count = 0
    for _ in range(_ITERATIONS):
        length = math.sqrt(x * x + y * y + z * z)
        if not length > 1e-12:
            break
        x, y, z = x / length, y / length, z / length
        ax, ay, az = farthest(first, x, y, z)
        bx, by, bz = farthest(second, -x, -y, -z)
        bx, by, bz = bx - ax, by - ay, bz - az
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = bx, by, bz
        bound = x * bx + y * by + z * bz
        if bound > lower:
            lower, nx, ny, nz = bound, x, y, z
        if lower > enough_m or upper - lower <= max(_CLOSED_M, _SHARE * (lower - asked_m)):
            break
        count, x, y, z = towards_origin(simplex, count + 1, lower > 0.0)
        between = math.sqrt(x * x + y * y + z * z)
        if between < upper:
            upper = between
    if lower > enough_m:
        upper = math.inf
    return lower - balls - ROUNDING_M, max(upper - balls, 0.0) + ROUNDING_M, nx, ny, nz


@inlined
def farthest(body: PlacedBody, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The point of a body, without its ball, that is farthest along (x, y, z)."""
    corners = body.corners
    best, most = 0, -math.inf
    for corner in range(body.corner_count):
        reach = corners[corner, 0] * x + corners[corner, 1] * y + corners[corner, 2] * z
        if reach > most:
            best, most = corner, reach
    px, py, pz = corners[best, 0], corners[best, 1], corners[best, 2]
    if body.disc > 0.0:
        # twice: of a direction along the axis the first remainder is rounding, and has a part along the axis again
        for _ in range(2):
            along = body.axis_x * x + body.axis_y * y + body.axis_z * z
            x, y, z = x - along * body.axis_x, y - along * body.axis_y, z - along * body.axis_z
        across = math.sqrt(x * x + y * y + z * z)
        if across > 1e-12:
            share = body.disc / across
            px, py, pz = px + share * x, py + share * y, pz + share * z
    return px, py, pz


# The point of a simplex that is nearest to the origin, after Ericson, Real-Time Collision Detection (2005), 5.1.

SimplexPoint = tuple[int, float, float, float]
"""Which corners of a simplex hold the point, as bits, and its coordinates."""


@inlined
def towards_origin(simplex: Array, count: int, is_outside: bool) -> SimplexPoint:
    """Nearest point to the origin of the first `count` rows of `simplex` (4, 3), which are reduced to what holds it.

    Args:
        simplex: is changed in place.
        count: 1 to 4.
        is_outside: whether the origin is known not to be inside.

    Returns:
        How many rows are left, and the point; the origin itself if it is inside four.
    """
    if count == 1:
        held, x, y, z = 1, simplex[0, 0], simplex[0, 1], simplex[0, 2]
    elif count == 2:
        held, x, y, z = _of_edge(simplex, 0, 1)
    elif count == 3:
        held, x, y, z = _of_triangle(simplex, 0, 1, 2)
    elif not is_outside and _holds_origin(simplex):
        return 4, 0.0, 0.0, 0.0
    else:
        held, x, y, z = _nearer(_of_triangle(simplex, 0, 1, 3), _of_triangle(simplex, 0, 2, 3))
        held, x, y, z = _nearer((held, x, y, z), _of_triangle(simplex, 1, 2, 3))
        held, x, y, z = _nearer((held, x, y, z), _of_triangle(simplex, 0, 1, 2))
    kept = 0
    for row in range(4):
        if held >> row & 1:
            simplex[kept, 0], simplex[kept, 1], simplex[kept, 2] = (
                simplex[row, 0],
                simplex[row, 1],
                simplex[row, 2],
            )
            kept += 1
    return kept, x, y, z


@inlined
def _nearer(one: SimplexPoint, other: SimplexPoint) -> SimplexPoint:
    """The one of two points that is nearer to the origin."""
    a = one[1] * one[1] + one[2] * one[2] + one[3] * one[3]
    b = other[1] * other[1] + other[2] * other[2] + other[3] * other[3]
    return other if b < a else one


@inlined
def _of_edge(simplex: Array, i: int, j: int) -> SimplexPoint:
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    bx, by, bz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    along, square = -(ax * bx + ay * by + az * bz), bx * bx + by * by + bz * bz
    if along <= 0.0 or square == 0.0:
        return 1 << i, ax, ay, az
    if along >= square:
        return 1 << j, simplex[j, 0], simplex[j, 1], simplex[j, 2]
    t = along / square
    return 1 << i | 1 << j, ax + t * bx, ay + t * by, az + t * bz


@inlined
def _of_triangle(simplex: Array, i: int, j: int, k: int) -> SimplexPoint:
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    bx, by, bz = simplex[j, 0], simplex[j, 1], simplex[j, 2]
    cx, cy, cz = simplex[k, 0], simplex[k, 1], simplex[k, 2]
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    d1, d2 = -(ux * ax + uy * ay + uz * az), -(vx * ax + vy * ay + vz * az)
    d3, d4 = -(ux * bx + uy * by + uz * bz), -(vx * bx + vy * by + vz * bz)
    d5, d6 = -(ux * cx + uy * cy + uz * cz), -(vx * cx + vy * cy + vz * cz)
    of_c, of_b, of_a = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if of_a > 0.0 and of_b > 0.0 and of_c > 0.0:
        s, t = of_b / (of_a + of_b + of_c), of_c / (of_a + of_b + of_c)
        return 1 << i | 1 << j | 1 << k, ax + s * ux + t * vx, ay + s * uy + t * vy, az + s * uz + t * vz
    return _nearer(_nearer(_of_edge(simplex, i, j), _of_edge(simplex, i, k)), _of_edge(simplex, j, k))


@inlined
def _holds_origin(simplex: Array) -> bool:
    """Whether the origin is inside a tetrahedron that has a volume."""
    return (
        _is_behind(simplex, 0, 1, 2, 3)
        and _is_behind(simplex, 0, 1, 3, 2)
        and _is_behind(simplex, 0, 2, 3, 1)
        and _is_behind(simplex, 1, 2, 3, 0)
    )


@inlined
def _is_behind(simplex: Array, i: int, j: int, k: int, other: int) -> bool:
    """Whether the origin is on the side of face i, j, k where the other corner is."""
    ax, ay, az = simplex[i, 0], simplex[i, 1], simplex[i, 2]
    ux, uy, uz = simplex[j, 0] - ax, simplex[j, 1] - ay, simplex[j, 2] - az
    vx, vy, vz = simplex[k, 0] - ax, simplex[k, 1] - ay, simplex[k, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    of_origin = -(nx * ax + ny * ay + nz * az)
    of_other = nx * (simplex[other, 0] - ax) + ny * (simplex[other, 1] - ay) + nz * (simplex[other, 2] - az)
    return bool(of_origin * of_other > 0.0 and abs(of_other) > 1e-12)
