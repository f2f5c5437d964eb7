"""One look of the gate at many pairs of bodies.

`look` measures bodies that are inflated by their travel, pair by pair; `separate` checks the open pairs by planes,
first fixed ones and then turning ones. Balls and boxes leave most pairs out, planes between the bodies
at the middle nearly all others (`deltaq_cell.kernel.gap`): a pair is left out only by a lower bound, rounding taken
off, that exceeds what is asked.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Findings, Integers, Pairs, Placed, PlacedBody
from deltaq_cell.kernel.gap import ROUNDING_M, body_at, gap
from deltaq_protocol.arrays import Array

NONE = -1
"""The tightest of no pairs."""


@makes_no_array
def look(
    cell: Anatomy,
    placed: Placed,
    pairs: Pairs,
    chosen: Integers,
    room_m: float,
    aims: bool,
    tells: bool,
    found: Findings,
) -> tuple[int, bool, bool, int]:
    """Find the pairs that are not shown to have `room_m` beyond their stop distance.

    Args:
        cell: the fixed data of the cell.
        placed: placements of the robots.
        pairs: of the cell.
        chosen: (k,) indices of those that are looked at.
        room_m: required clearance beyond the stop distance [m].
        aims: whether searches begin from scratch; if not, they begin with the last normals.
        tells: whether the tightest pair is asked for also where none is open.
        found: receives the findings; `open` has the pairs.

    Returns:
        Index of the pair with the least swept distance beyond its stop distance, whether pairs are open, whether one
        of those has not got its room even at the middle, and how many pairs were searched.
    """
    nearest = _screen(cell, placed, pairs, chosen, aims, found)
    if nearest == NONE:
        return NONE, False, False, 0
    # the one whose ball is nearest has often the least room, so that the others need not be measured to the end
    tightest, least, any_open, too_near, searched = NONE, math.inf, False, False, 0
    for step in range(-1, len(chosen)):
        index = nearest if step < 0 else chosen[step]
        enough = max(room_m, least) if tells else room_m
        if (step >= 0 and index == nearest) or found.room_m[index] > enough:
            continue
        first, second = pairs.first[index], pairs.second[index]
        kept = pairs.stop_m[index] + found.travel_m[index]
        normal = found.normal[index]
        free, x, y, z = apart(cell, placed, first, second)
        if free - ROUNDING_M - kept > enough:
            found.room_m[index] = free - ROUNDING_M - kept
            continue
        if aims and free > 0.0:
            normal[0], normal[1], normal[2] = x, y, z
        one, other = body_at(cell, placed, first), body_at(cell, placed, second)
        asked_m = math.inf if tells else pairs.stop_m[index] + room_m
        searched += 1
        lower, upper, x, y, z = gap(
            one, other, normal[0], normal[1], normal[2], enough + kept, asked_m, found.simplex
        )
        normal[0], normal[1], normal[2] = x, y, z
        found.at_most_m[index], found.room_m[index] = upper, lower - kept
        if tightest == NONE or upper - kept < least:
            tightest, least = index, upper - kept
        if lower - kept < room_m:
            found.open[index] = any_open = True
            too_near = too_near or upper < pairs.stop_m[index] + room_m
    return tightest, any_open, too_near, searched


@inlined
def separate(
    cell: Anatomy, placed: Placed, pairs: Pairs, chosen: Integers, room_m: float, found: Findings
) -> None:
    """Close the open pairs that planes keep apart over the spans where robots are; none is too near at the middle.

    Args:
        cell: the fixed data of the cell.
        placed: placements of the robots.
        pairs: of the cell.
        chosen: (k,) indices of those that were looked at.
        room_m: required clearance beyond the stop distance [m].
        found: of that look, is written to.
    """
    for index in chosen:
        if found.open[index]:
            first, second, asked_m = pairs.first[index], pairs.second[index], pairs.stop_m[index] + room_m
            at_most_m = found.at_most_m[index]
            found.open[index] = not keeps(
                cell, placed, first, second, found.normal[index], at_most_m, asked_m, found.twist
            )


@makes_no_array
def separate_pairs(
    cell: Anatomy, placed: Placed, pairs: Pairs, chosen: Integers, room_m: float, found: Findings
) -> None:
    """`separate`, for callers outside of the kernel."""
    separate(cell, placed, pairs, chosen, room_m, found)


@inlined
def _screen(
    cell: Anatomy, placed: Placed, pairs: Pairs, chosen: Integers, aims: bool, found: Findings
) -> int:
    """Bound the room of every pair by the balls and boxes around its bodies; returns the one with the least.

    If it `aims`, what balls do not touch is left as a direction from first to second, to begin a search with.
    """
    robot, radius, box, centre = cell.robot, cell.radius, cell.box, placed.centre
    travel, arms, half, moved_by = placed.travel, placed.arms, placed.half, cell.moved_by
    nearest, least = NONE, math.inf
    for index in chosen:
        found.open[index] = False
        one, other = pairs.first[index], pairs.second[index]
        if robot[one] != robot[other]:
            swept = travel[one] + travel[other]
        else:
            swept = 0.0
            for joint in range(cell.first_joint[one], cell.last_joint[one]):
                # a joint that moves both leaves their distance as it is
                if moved_by[one, joint] != moved_by[other, joint]:
                    swept += half[joint] * (arms[one, joint] + arms[other, joint])
        square, inside = 0.0, -math.inf
        for k in range(3):
            way = centre[other, k] - centre[one, k]
            beyond = abs(way) - box[one, k] - box[other, k]
            inside = max(inside, beyond)
            if beyond > 0.0:
                square += beyond**2
            if aims:
                found.normal[index, k] = math.copysign(beyond, way) if beyond > 0.0 else 0.0
        if aims and square == 0.0:
            for k in range(3):
                found.normal[index, k] = centre[other, k] - centre[one, k]
        # of a middle within a box as far as it is from there to the nearest face, the other way
        between = math.sqrt(square) if square > 0.0 else inside
        distance = between - radius[one] - radius[other] - ROUNDING_M
        found.travel_m[index] = swept
        found.room_m[index] = distance - swept - pairs.stop_m[index]
        if nearest == NONE or found.room_m[index] < least:
            nearest, least = index, found.room_m[index]
    return nearest


# The screen by tight boxes. Of any unit vector n, what two boxes leave free between them along n is no more than the
# distance of the bodies in them. Tried are the normals of the boxes' faces.


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


# Planes, as docs/explanation/the-gate.md derives them: first one that is fixed while the bodies move through the
# span, then one that turns with either body.


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
        cell: the fixed data of the cell.
        placed: placements of the bodies.
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
    """Whether a fixed plane with the normal n shows the requested distance."""
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
    """Whether a plane that turns with a body shows the requested distance; n points from that body to the other."""
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
