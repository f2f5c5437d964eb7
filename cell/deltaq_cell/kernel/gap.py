"""The kernel's distances: bounds from below and from above, each proved by what is easy to check.

From below by a plane: of any unit vector n, what two bodies leave free between them along n is no more than their
distance. From above by two points, one of each body. The search for the best plane is that of Gilbert, Johnson and
Keerthi (1988, IEEE J. Robotics and Automation 4(2)), but neither bound rests on how well it goes: a search that went
astray would leave a gap between them, and a pair whose bound from below is too small is never taken for far apart.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined
from deltaq_cell.kernel.arrays import Anatomy, Placed, PlacedBody
from deltaq_cell.kernel.simplex import towards_origin
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
    """A body where it is placed."""
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
