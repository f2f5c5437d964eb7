"""The kernel's planes: what `deltaq_cell.separation` says, with its words and for one pair at a time.

First a plane that stands still while the bodies move through the span, then one that turns with either body.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined
from deltaq_cell.kernel.arrays import Anatomy, Placed, PlacedBody
from deltaq_cell.kernel.gap import body_at
from deltaq_protocol.arrays import Array


@inlined
def keeps(
    cell: Anatomy,
    placed: Placed,
    first: int,
    second: int,
    normal: Array,
    distance_m: float,
    asked_m: float,
    twist: Array,
) -> bool:
    """Whether planes keep two bodies apart over the spans where their robots are placed.

    Args:
        cell: what stays.
        placed: where the bodies are.
        first: number of a body.
        second: number of the other.
        normal: (3,) unit vector from the first to the second.
        distance_m: at most theirs at the middle of the spans; no plane can show more [m].
        asked_m: least distance to be shown [m].
        twist: (2, VERTICES, 6), is written to.
    """
    blur, slides = _motion(cell, placed, first, second, twist[0])
    other_blur, other_slides = _motion(cell, placed, second, first, twist[1])
    asked_m += blur + other_blur
    slides += other_slides
    if distance_m < asked_m:
        return False
    ones, others = _vertices(cell, placed, first), _vertices(cell, placed, second)
    # bodies of one robot are at the same place of its span
    together = cell.robot[first] == cell.robot[second] and ones > 1 and others > 1
    one, other = body_at(cell, placed, first), body_at(cell, placed, second)
    nx, ny, nz = normal[0], normal[1], normal[2]
    if _shown_by_standing(one, other, ones, others, nx, ny, nz, together, asked_m, twist):
        return True
    for side in range(2):
        sign = 1.0 - 2.0 * side
        turning, facing = (one, other) if side == 0 else (other, one)
        mine, theirs = (ones, others) if side == 0 else (others, ones)
        x, y, z = sign * nx, sign * ny, sign * nz
        if _shown_by_turning(
            turning, facing, mine, theirs, x, y, z, together, asked_m, slides, twist[side], twist[1 - side]
        ):
            return True
    return False


@inlined
def _vertices(cell: Anatomy, placed: Placed, body: int) -> int:
    """How many places of its robot's span a body has to be looked at; a body that stands has one."""
    return int(placed.vertices[cell.robot[body]]) if cell.carrier[body] >= 0 else 1


@inlined
def _shown_by_standing(
    first: PlacedBody,
    second: PlacedBody,
    ones: int,
    others: int,
    nx: float,
    ny: float,
    nz: float,
    together: bool,
    asked_m: float,
    twist: Array,
) -> bool:
    """Whether a plane that stands, with the normal n, shows what is asked."""
    mine = theirs = both = -math.inf
    here = there = 0.0
    for vertex in range(max(ones, others)):
        # a body that has no such vertex is where it was
        if vertex < ones:
            here = _reach(first, twist[0, vertex], nx, ny, nz, nx, ny, nz)
            mine = max(mine, here)
        if vertex < others:
            there = _reach(second, twist[1, vertex], -nx, -ny, -nz, -nx, -ny, -nz)
            theirs = max(theirs, there)
        both = max(both, here + there)
    return -(both if together else mine + theirs) >= asked_m


@inlined
def _shown_by_turning(
    turning: PlacedBody,
    other: PlacedBody,
    ones: int,
    others: int,
    nx: float,
    ny: float,
    nz: float,
    together: bool,
    asked_m: float,
    slides: float,
    twist: Array,
    other_twist: Array,
) -> bool:
    """Whether a plane that turns with a body shows what is asked; n points from that body to the other."""
    square = 0.0
    for vertex in range(ones):
        wx, wy, wz = twist[vertex, 3], twist[vertex, 4], twist[vertex, 5]
        x, y, z = wy * nz - wz * ny, wz * nx - wx * nz, wx * ny - wy * nx
        square = max(square, x * x + y * y + z * z)
    if square == 0.0:
        return False
    asked_m = max(asked_m, asked_m * math.sqrt(1.0 + square)) + math.sqrt(square) * slides
    stands = _support(turning, nx, ny, nz)
    for vertex in range(ones):
        wx, wy, wz = twist[vertex, 3], twist[vertex, 4], twist[vertex, 5]
        ax, ay, az = nx + wy * nz - wz * ny, ny + wz * nx - wx * nz, nz + wx * ny - wy * nx
        # its own turning leaves it where it is before the plane
        mine = stands + nx * twist[vertex, 0] + ny * twist[vertex, 1] + nz * twist[vertex, 2]
        for theirs in range(others):
            if together and theirs != vertex:
                continue
            reach = mine + _reach(other, other_twist[theirs], -nx, -ny, -nz, -ax, -ay, -az)
            if not -reach >= asked_m:
                return False
    return True


@inlined
def _reach(
    body: PlacedBody, twist: Array, nx: float, ny: float, nz: float, ax: float, ay: float, az: float
) -> float:
    """How far a body reaches at a vertex, to first order, along a that is met by its motion as n [m]."""
    wx, wy, wz = twist[3], twist[4], twist[5]
    ax += ny * wz - nz * wy
    ay += nz * wx - nx * wz
    az += nx * wy - ny * wx
    return float(_support(body, ax, ay, az) + nx * twist[0] + ny * twist[1] + nz * twist[2])


@inlined
def _support(body: PlacedBody, ax: float, ay: float, az: float) -> float:
    """How far a body reaches along a where it is placed [m]."""
    corners, most = body.corners, -math.inf
    for corner in range(body.corner_count):
        most = max(most, corners[corner, 0] * ax + corners[corner, 1] * ay + corners[corner, 2] * az)
    if body.disc > 0.0:
        along = body.axis_x * ax + body.axis_y * ay + body.axis_z * az
        x, y, z = ax - along * body.axis_x, ay - along * body.axis_y, az - along * body.axis_z
        most += body.disc * math.sqrt(x * x + y * y + z * z)
    if body.ball > 0.0:
        most += body.ball * math.sqrt(ax * ax + ay * ay + az * az)
    return float(most)


@inlined
def _motion(cell: Anatomy, placed: Placed, body: int, other: int, twist: Array) -> tuple[float, float]:
    """A body's motion over the span; joints that move the other one as well leave them as they are.

    Writes its twist from the middle to each vertex (VERTICES, 6), and returns what deviation and bend may add to its
    side, and how far it travels between vertices [m].
    """
    first, last, arms = cell.first_joint[body], cell.last_joint[body], placed.arms[body]
    vertices = _vertices(cell, placed, body)
    for vertex in range(vertices):
        for row in range(6):
            twist[vertex, row] = 0.0
    travel = slides = 0.0
    for joint in range(first, last):
        if cell.moved_by[body, joint] and not cell.moved_by[other, joint]:
            travel += placed.half[joint] * arms[joint]
            slides += placed.along[joint] * arms[joint]
            for vertex in range(vertices):
                for row in range(6):
                    twist[vertex, row] += placed.columns[joint, row] * placed.offset[vertex, joint]
    blur = before = 0.0
    for joint in range(first, last):
        if cell.moved_by[body, joint] and not cell.moved_by[other, joint]:
            half = placed.half[joint]
            turns = half if cell.revolute[joint] else 0.0
            blur += arms[joint] * placed.deviation[joint] + half * (arms[joint] + travel) * (
                before + 0.5 * turns
            )
            before += turns
    return blur, slides
