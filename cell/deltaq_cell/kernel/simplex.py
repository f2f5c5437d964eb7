"""The point of a simplex that is nearest to the origin, after Ericson, Real-Time Collision Detection (2005), 5.1."""

from __future__ import annotations

from deltaq_cell.compiled import inlined
from deltaq_protocol.arrays import Array

SimplexPoint = tuple[int, float, float, float]
"""Which corners of a simplex hold the point, as bits, and its coordinates."""


@inlined
def towards_origin(simplex: Array, count: int, is_outside: bool) -> SimplexPoint:
    """Nearest point to the origin of the first `count` rows of `simplex` (4, 3), which are reduced to what holds it.

    Args:
        simplex: is written to.
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
