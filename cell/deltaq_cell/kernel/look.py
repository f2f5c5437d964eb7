"""One look of the gate at many pairs of bodies.

It answers what `deltaq_cell.proximity` does, pair by pair: `look` with bodies inflated by their travel, and for what
that leaves open `separate` with planes, first those that stand and then those that turn. Balls and boxes leave most
pairs out, planes between the bodies at the middle nearly all others (`deltaq_cell.kernel.gap`): a pair is left out only
by a lower bound, rounding taken off, that exceeds what is asked.
"""

from __future__ import annotations

import math

from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Findings, Integers, Pairs, Placed
from deltaq_cell.kernel.boxes import apart
from deltaq_cell.kernel.gap import ROUNDING_M, body_at, gap
from deltaq_cell.kernel.planes import keeps

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
        cell: what stays.
        placed: where the robots are.
        pairs: of the cell.
        chosen: (k,) indices of those that are looked at.
        room_m: what is asked for [m].
        aims: whether searches begin anew; if not, they begin with the normals that were found last.
        tells: whether the tightest pair is asked for also where none is open.
        found: is written to; its `open` tells the pairs.

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
        cell: what stays.
        placed: where the robots are.
        pairs: of the cell.
        chosen: (k,) indices of those that were looked at.
        room_m: what is asked for [m].
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
