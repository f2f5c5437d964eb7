"""The kernel's planes: what `deltaq_cell.separation` says, with its words and for one pair at a time.

First a plane that stands still while the bodies move through the strip, then one that turns with either body.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Placed, PlacedBody
from deltaq_cell.kernel.gap import body_at
from deltaq_protocol.arrays import Array


@makes_no_array
def keeps_apart(
    cell: Anatomy,
    placed: Placed,
    first: int,
    second: int,
    normal: Array,
    distance_m: float,
    asked_m: float,
    twist: Array,
) -> bool:
    """`keeps`, for callers outside of the kernel."""
    return keeps(cell, placed, first, second, normal, distance_m, asked_m, twist)


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
    """Whether planes keep two bodies apart over the strips where their robots are placed.

    Args:
        cell: what stays.
        placed: where the bodies are.
        first: number of a body.
        second: number of the other.
        normal: (3,) unit vector from the first to the second.
        distance_m: at most theirs at the middle of the strips; no plane can show more [m].
        asked_m: least distance to be shown [m].
        twist: (2, 6), is written to.
    """
    blur, slides = _motion(cell, placed, first, second, twist[0])
    other_blur, other_slides = _motion(cell, placed, second, first, twist[1])
    asked_m += blur + other_blur
    slides += other_slides
    if distance_m < asked_m:
        return False
    one, other = body_at(cell, placed, first), body_at(cell, placed, second)
    # bodies of one robot are at the same t
    together = cell.robot[first] == cell.robot[second]
    nx, ny, nz = normal[0], normal[1], normal[2]
    if _shows(one, other, nx, ny, nz, 0.0, 0.0, 0.0, 0, together, asked_m, twist):
        return True
    for body in range(2):
        wx, wy, wz = twist[body, 3], twist[body, 4], twist[body, 5]
        x, y, z = wy * nz - wz * ny, wz * nx - wx * nz, wx * ny - wy * nx
        square = x * x + y * y + z * z
        if square == 0.0:
            continue
        more = max(asked_m, asked_m * math.sqrt(1.0 + square)) + math.sqrt(square) * slides
        if _shows(one, other, nx, ny, nz, x, y, z, body, together, more, twist):
            return True
    return False


@inlined
def _shows(
    first: PlacedBody,
    second: PlacedBody,
    nx: float,
    ny: float,
    nz: float,
    x: float,
    y: float,
    z: float,
    body: int,
    together: bool,
    asked_m: float,
    twist: Array,
) -> bool:
    """Whether a plane shows what is asked, with the normal n + t (x, y, z) at the t of the first or second body."""
    # a body that stands is the same at both ends of its t
    stands = _is_zero(twist[0]) or _is_zero(twist[1])
    for corner in range(4):
        mine, theirs = 2.0 * (corner & 1) - 1.0, 2.0 * (corner >> 1) - 1.0
        if mine != theirs and (together or stands):
            continue
        t = mine if body == 0 else theirs
        ax, ay, az = nx + t * x, ny + t * y, nz + t * z
        reach = _reach(first, twist[0], nx, ny, nz, ax, ay, az, mine)
        reach += _reach(second, twist[1], -nx, -ny, -nz, -ax, -ay, -az, theirs)
        if not -reach >= asked_m:
            return False
    return True


@inlined
def _is_zero(twist: Array) -> bool:
    most = 0.0
    for row in range(6):
        most = max(most, abs(twist[row]))
    return most == 0.0


@inlined
def _reach(
    body: PlacedBody, twist: Array, nx: float, ny: float, nz: float, ax: float, ay: float, az: float, t: float
) -> float:
    """How far a body reaches at t, to first order, along a that is met by its motion as n [m]."""
    wx, wy, wz = twist[3], twist[4], twist[5]
    ax += t * (ny * wz - nz * wy)
    ay += t * (nz * wx - nx * wz)
    az += t * (nx * wy - ny * wx)
    corners, most = body.corners, -math.inf
    for corner in range(body.corner_count):
        most = max(most, corners[corner, 0] * ax + corners[corner, 1] * ay + corners[corner, 2] * az)
    if body.disc > 0.0:
        along = body.axis_x * ax + body.axis_y * ay + body.axis_z * az
        x, y, z = ax - along * body.axis_x, ay - along * body.axis_y, az - along * body.axis_z
        most += body.disc * math.sqrt(x * x + y * y + z * z)
    if body.ball > 0.0:
        most += body.ball * math.sqrt(ax * ax + ay * ay + az * az)
    return float(most + t * (nx * twist[0] + ny * twist[1] + nz * twist[2]))


@inlined
def _motion(cell: Anatomy, placed: Placed, body: int, other: int, twist: Array) -> tuple[float, float]:
    """A body's motion over the strip; joints that move the other one as well leave them as they are.

    Writes its twist (6,), and returns what deviation and bend may add to its side, and how far it travels along
    the strip without what that is wide [m].
    """
    first, last, arms = cell.first_joint[body], cell.last_joint[body], placed.arms[body]
    for row in range(6):
        twist[row] = 0.0
    travel = slides = 0.0
    for joint in range(first, last):
        if cell.moved_by[body, joint] and not cell.moved_by[other, joint]:
            travel += placed.half[joint] * arms[joint]
            slides += abs(placed.direction[joint]) * arms[joint]
            for row in range(6):
                twist[row] += placed.columns[joint, row] * placed.direction[joint]
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
