"""The kernel's pieces of tubes: windows or strips of joint space, on a stack, each divided into two halves.

`deltaq_services.sim.tube` says the same in plain words. A row of the stack is a piece of one robot's tube, a piece of
another's, and the pairs of bodies that have not been shown to keep apart in them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import inlined
from deltaq_cell.kernel.arrays import Integers, Pairs
from deltaq_cell.kernel.strip import write_strip
from deltaq_protocol.arrays import Array, Flags

MINE, THEIRS = 0, 1
"""The two robots of a row; without another robot the second piece is never divided."""

SHORTEST = 1e-7
"""Strips are not divided below this half-length [rad or m]."""

ROWS = 128
"""Of a stack: windows and strips are halved fewer than a hundred times on the way to their smallest parts."""

_NOWHERE = -1
"""Serial number of no piece."""

_STRIP = -1
"""In place of the first window of a piece that is a strip."""


class Tube(NamedTuple):
    """Windows of one robot's tube; no points stand for no robot.

    Attributes:
        points: (k, n) setpoints, past and to come [rad or m].
        lag: how many setpoints back the drives may be.
        first: the first window.
        last: the last window.
        joints: the robot's first joint, and one more than its last.
        bodies: the same of its bodies.
    """

    points: Array
    lag: int
    first: int
    last: int
    joints: tuple[int, int]
    bodies: tuple[int, int]


class Stack(NamedTuple):
    """Pieces that are still to be looked at, and what was looked at last.

    Attributes:
        window: (rows, 2, 2) first and last window of each piece; of a strip the first is -1.
        middle: (rows, 2, joints) of the strip around each piece [rad or m].
        direction: (rows, 2, joints) [rad or m].
        deviation: (rows, 2, joints) [rad or m].
        serial: (rows, 2) number of each piece, which tells it from all others.
        greatest: (2,) travel of the bodies of either robot where it was placed last [m].
        placed: (2, 2) serial number of the piece where it was placed, and where the pairs began whose bodies were.
        part: (rows, 2) where in `chosen` the pairs of each row begin and end.
        chosen: indices of pairs, those of a row after those of the rows that it is part of.
        wanted: (bodies,) the bodies of the pairs of one row.
        aside: (2, joints) scratch.
        told: (2, joints) middles of the pieces in which the pair that is told was found [rad or m].
    """

    window: Integers
    middle: Array
    direction: Array
    deviation: Array
    serial: Integers
    greatest: Array
    placed: Integers
    part: Integers
    chosen: Integers
    wanted: Flags
    aside: Array
    told: Array


def stack_of(joints: int, bodies: int, pairs: int, rows: int = ROWS) -> Stack:
    """An empty stack for a cell of that many joints, bodies and pairs."""
    return Stack(
        window=np.zeros((rows, 2, 2), dtype=np.int64),
        middle=np.zeros((rows, 2, joints)),
        direction=np.zeros((rows, 2, joints)),
        deviation=np.zeros((rows, 2, joints)),
        serial=np.zeros((rows, 2), dtype=np.int64),
        greatest=np.zeros(2),
        placed=np.zeros((2, 2), dtype=np.int64),
        part=np.zeros((rows, 2), dtype=np.int64),
        chosen=np.zeros(rows * max(pairs, 1), dtype=np.int64),
        wanted=np.zeros(bodies, dtype=bool),
        aside=np.zeros((2, joints)),
        told=np.zeros((2, joints)),
    )


@inlined
def begin(stack: Stack, mine: Tube, theirs: Tube, pairs: Pairs, asked: Integers) -> int:
    """Fill the first row with whole tubes and those pairs of `asked` that are active; returns how many there are."""
    count = 0
    for index in asked:
        if pairs.active[index]:
            stack.chosen[count] = index
            count += 1
    stack.window[0, MINE, 0], stack.window[0, MINE, 1] = mine.first, mine.last
    stack.window[0, THEIRS, 0], stack.window[0, THEIRS, 1] = theirs.first, theirs.last
    stack.part[0, 0], stack.part[0, 1] = 0, count
    for side in range(2):
        stack.serial[0, side], stack.placed[side, 0] = 0, _NOWHERE
    return count


@inlined
def want(stack: Stack, row: int, pairs: Pairs) -> None:
    """Mark the bodies of a row's pairs."""
    for body in range(len(stack.wanted)):
        stack.wanted[body] = False
    for place in range(stack.part[row, 0], stack.part[row, 1]):
        index = stack.chosen[place]
        stack.wanted[pairs.first[index]] = stack.wanted[pairs.second[index]] = True


@inlined
def lay_strip(stack: Stack, row: int, side: int, tube: Tube) -> None:
    """Lay the strip of a piece of windows around their setpoints; a strip is as it is."""
    first, last = stack.window[row, side, 0], stack.window[row, side, 1]
    if first == _STRIP:
        return
    start = max(0, min(first - tube.lag, len(tube.points) - 1))
    write_strip(
        tube.points[start : last + 1],
        stack.middle[row, side],
        stack.direction[row, side],
        stack.deviation[row, side],
        stack.aside,
    )


@inlined
def divides(stack: Stack, row: int, side: int, tube: Tube) -> bool:
    """Whether a piece whose strip is laid can be divided."""
    return _by_windows(stack, row, side, tube) or _by_length(stack, row, side, tube)


@inlined
def divide(stack: Stack, row: int, side: int, tube: Tube, serial: int) -> None:
    """Put the second half of a piece on the row above, with the same piece of the other robot; the first stays.

    The halves get the number `serial` and the next.
    """
    stack.serial[row, side], stack.serial[row + 1, side] = serial, serial + 1
    stack.serial[row + 1, 1 - side] = stack.serial[row, 1 - side]
    for both in range(2):
        for k in range(2):
            stack.window[row + 1, both, k] = stack.window[row, both, k]
        for joint in range(stack.middle.shape[2]):
            stack.middle[row + 1, both, joint] = stack.middle[row, both, joint]
            stack.direction[row + 1, both, joint] = stack.direction[row, both, joint]
            stack.deviation[row + 1, both, joint] = stack.deviation[row, both, joint]
    stack.part[row + 1, 0], stack.part[row + 1, 1] = stack.part[row, 0], stack.part[row, 1]
    if _by_windows(stack, row, side, tube):
        middle = (stack.window[row, side, 0] + stack.window[row, side, 1]) // 2
        stack.window[row, side, 1], stack.window[row + 1, side, 0] = middle, middle + 1
        return
    for half in range(2):
        stack.window[row + half, side, 0] = _STRIP
        for joint in range(tube.points.shape[1]):
            shift = stack.direction[row + half, side, joint] / 2.0
            stack.direction[row + half, side, joint] = shift
            stack.middle[row + half, side, joint] += shift if half else -shift


@inlined
def _by_windows(stack: Stack, row: int, side: int, tube: Tube) -> bool:
    """Whether a piece has several windows that are no straight line together."""
    first, last = stack.window[row, side, 0], stack.window[row, side, 1]
    return bool(
        len(tube.points) > 0
        and first != _STRIP
        and first != last
        and _widest(stack.deviation[row, side], tube.points.shape[1]) >= SHORTEST
    )


@inlined
def _by_length(stack: Stack, row: int, side: int, tube: Tube) -> bool:
    joints = tube.points.shape[1]
    shortest = max(SHORTEST, _widest(stack.deviation[row, side], joints))
    return bool(len(tube.points) > 0 and _widest(stack.direction[row, side], joints) >= shortest)


@inlined
def _widest(of: Array, joints: int) -> float:
    widest = 0.0
    for joint in range(joints):
        widest = max(widest, abs(of[joint]))
    return widest
