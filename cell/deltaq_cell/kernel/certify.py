"""The kernel's certificate: tubes are looked at in pieces, divided where a look is too coarse, and pair by pair.

`deltaq_services.sim.certificate` says the same in plain words, for groups of pairs. Here each half of a piece is asked
only for those pairs that the whole left open, since what holds in a piece holds in its halves.
"""

from __future__ import annotations

from typing import NamedTuple

from deltaq_cell.compiled import inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Findings, Integers, Pairs, Placed
from deltaq_cell.kernel.look import NONE, look, separate
from deltaq_cell.kernel.pieces import (
    MINE,
    THEIRS,
    Stack,
    Tube,
    begin,
    divide,
    divides,
    lay_box,
    lay_span,
    want,
)
from deltaq_cell.kernel.place import place, spread


class TubesCertified(NamedTuple):
    """What came of a certificate.

    Attributes:
        holds: whether every pair keeps what it has to, anywhere in the tubes.
        left: what is left of the budget.
        told: index of the pair with the least room, in the first look or in that which failed; -1 for none.
        travel_m: how far the two bodies travel together in that look [m].
        least_m: bound of their room from below [m].
        most_m: and from above [m].
        too_near: whether a pair was too near at the middle where it failed.
        first_open: where in `Stack.chosen` the pairs begin that were left open where it failed.
        last_open: one more than where they end.
    """

    holds: bool
    left: int
    told: int
    travel_m: float
    least_m: float
    most_m: float
    too_near: bool
    first_open: int
    last_open: int


@makes_no_array
def certify(
    cell: Anatomy,
    placed: Placed,
    mine: Tube,
    theirs: Tube,
    pairs: Pairs,
    asked: Integers,
    room_m: float,
    budget: int,
    tells: bool,
    stack: Stack,
    found: Findings,
) -> TubesCertified:
    """Whether pairs keep `room_m` beyond their stop distance anywhere in two tubes, or in one.

    Args:
        cell: what stays.
        placed: is written to; afterwards only some bodies are placed.
        mine: tube of one robot.
        theirs: tube of another; without points, all pairs are of the one robot and what stands.
        pairs: of the cell, or some; every stop distance and `room_m` together are positive.
        asked: (k,) indices of those that are asked about, if they are active.
        room_m: what is asked for [m].
        budget: how many pairs may be searched in parts of the tubes and be followed by others.
        tells: whether the pair with the least room is asked for also where all have theirs.
        stack: is written to.
        found: is written to.
    """
    told, travel_m, least_m, most_m = NONE, 0.0, 0.0, 0.0
    top = 1 if begin(stack, mine, theirs, pairs, asked) else 0
    whole, serial = True, 1
    while top > 0:
        row = top - 1
        first, last = stack.part[row]
        want(stack, row, pairs)
        _place(cell, placed, stack, row, MINE, mine)
        _place(cell, placed, stack, row, THEIRS, theirs)
        chosen = stack.chosen[first:last]
        tightest, any_open, too_near, searched = look(
            cell, placed, pairs, chosen, room_m, whole, whole and tells, found
        )
        if any_open and not too_near:
            _spread(cell, placed, stack, row, MINE, mine)
            _spread(cell, placed, stack, row, THEIRS, theirs)
            separate(cell, placed, pairs, chosen, room_m, found)
        if whole and tells:
            told, travel_m, least_m, most_m = _tell(stack, row, tightest, pairs, found)
        elif not whole:
            budget -= searched
        whole = False
        open_end = last
        for place_ in range(first, last):
            if found.open[stack.chosen[place_]]:
                stack.chosen[open_end] = stack.chosen[place_]
                open_end += 1
        if open_end == last:
            top -= 1
            continue
        # the one that travels further is divided first
        mine_divides = not too_near and divides(stack, row, MINE, mine)
        theirs_divides = not too_near and divides(stack, row, THEIRS, theirs)
        if budget < 0 or not (mine_divides or theirs_divides) or top == len(stack.part):
            told, travel_m, least_m, most_m = _tell(stack, row, tightest, pairs, found)
            return TubesCertified(False, budget, told, travel_m, least_m, most_m, too_near, last, open_end)
        stack.part[row, 0], stack.part[row, 1] = last, open_end
        further = stack.greatest[MINE] >= stack.greatest[THEIRS]
        if mine_divides and (further or not theirs_divides):
            divide(stack, row, MINE, mine, serial)
        else:
            divide(stack, row, THEIRS, theirs, serial)
        serial += 2
        top += 1
    return TubesCertified(True, budget, told, travel_m, least_m, most_m, False, 0, 0)


@inlined
def _place(cell: Anatomy, placed: Placed, stack: Stack, row: int, side: int, tube: Tube) -> None:
    """Place the bodies that are wanted, unless they are: rows below ask for the pairs of this row, or for more."""
    serial, first = stack.serial[row, side], stack.part[row, 0]
    if stack.placed[side, 0] == serial and stack.placed[side, 1] <= first:
        return
    stack.placed[side, 0], stack.placed[side, 1] = serial, first
    stack.greatest[side] = 0.0
    if len(tube.points) > 0:
        lay_box(stack, row, side, tube)
        stack.greatest[side] = place(
            cell,
            placed,
            tube.joints,
            tube.bodies,
            stack.wanted,
            stack.middle[row, side],
            stack.half[row, side],
        )


@inlined
def _spread(cell: Anatomy, placed: Placed, stack: Stack, row: int, side: int, tube: Tube) -> None:
    """Say which span a robot that is placed is in; only planes ask for it."""
    if len(tube.points) > 0:
        lay_span(stack, row, side, tube)
        offset, vertices = stack.offset[row, side], stack.vertices[row, side]
        spread(cell, placed, tube.joints, tube.bodies, offset, vertices, stack.deviation[row, side])


@inlined
def _tell(
    stack: Stack, row: int, tightest: int, pairs: Pairs, found: Findings
) -> tuple[int, float, float, float]:
    """Keep where a pair was found; returns the pair, its travel, and bounds of its room from below and above."""
    for side in range(2):
        for joint in range(stack.told.shape[1]):
            stack.told[side, joint] = stack.middle[row, side, joint]
    most_m = found.at_most_m[tightest] - found.travel_m[tightest] - pairs.stop_m[tightest]
    return tightest, found.travel_m[tightest], found.room_m[tightest], most_m
