"""The kernel's pieces of tubes: windows or spans of joint space, on a stack, each divided into two halves.

`deltaq_services.sim.tube` says the same in plain words. A row of the stack is a piece of one robot's tube, a piece of
another's, and the pairs of bodies that have not been shown to keep apart in them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import inlined
from deltaq_cell.kernel.arrays import Integers, Pairs
from deltaq_cell.kernel.span import SHORTEST, VERTICES, beside, centre, write_box, write_span
from deltaq_protocol.arrays import Array, Flags

MINE, THEIRS = 0, 1
"""The two robots of a row; without another robot the second piece is never divided."""

ROWS = 128
"""Of a stack: windows and spans are halved fewer than a hundred times on the way to their smallest parts."""

_NOWHERE = -1
"""Serial number of no piece."""

_SPAN = -1
"""In place of the first window of a piece that is a part of a span."""


class Tube(NamedTuple):
    """Windows of one robot's tube; no points stand for no robot.

    Attributes:
        points: (k, n) setpoints, past and to come [rad or m].
        lag: how many setpoints back the drives may be.
        first: the first window.
        last: the last window.
        tolerance: (n,) how far each joint may be beside the hull of its setpoints at rest [rad or m].
        spread: half of the greatest difference between the lags of two joints [cycles].
        joints: the robot's first joint, and one more than its last.
        bodies: the same of its bodies.
    """

    points: Array
    lag: int
    first: int
    last: int
    tolerance: Array
    spread: float
    joints: tuple[int, int]
    bodies: tuple[int, int]


class Stack(NamedTuple):
    """Pieces that are still to be checked, and scratch memory of the last one.

    Attributes:
        window: (rows, 2, 2) first and last window of each piece; of a part of a span the first is -1.
        middle: (rows, 2, joints) of the box around each piece [rad or m].
        half: (rows, 2, joints) its half-widths.
        vertices: (rows, 2) how many vertices the span around each piece has; zero if it is not laid.
        offset: (rows, 2, VERTICES, joints) of those from the middle of the box.
        deviation: (rows, 2, joints) [rad or m].
        straight: (rows, 2) whether the windows of each piece are one line, along which all joints lag alike.
        serial: (rows, 2) number of each piece, which tells it from all others.
        greatest: (2,) travel of the bodies of either robot where it was placed last [m].
        placed: (2, 2) serial number of the piece where it was placed, and where the pairs began whose bodies were.
        part: (rows, 2) where in `chosen` the pairs of each row begin and end.
        chosen: indices of pairs, those of a row after those of the rows that it is part of.
        wanted: (bodies,) the bodies of the pairs of one row.
        kept: (2, VERTICES) scratch.
        beside: (VERTICES,) scratch.
        aside: (2, joints) scratch.
        told: (2, joints) middles of the pieces with the reported pair [rad or m].
    """

    window: Integers
    middle: Array
    half: Array
    vertices: Integers
    offset: Array
    deviation: Array
    straight: Flags
    serial: Integers
    greatest: Array
    placed: Integers
    part: Integers
    chosen: Integers
    wanted: Flags
    kept: Integers
    beside: Array
    aside: Array
    told: Array


def stack_of(joints: int, bodies: int, pairs: int, rows: int = ROWS) -> Stack:
    """An empty stack for a cell of that many joints, bodies and pairs."""
    return Stack(
        window=np.zeros((rows, 2, 2), dtype=np.int64),
        middle=np.zeros((rows, 2, joints)),
        half=np.zeros((rows, 2, joints)),
        vertices=np.zeros((rows, 2), dtype=np.int64),
        offset=np.zeros((rows, 2, VERTICES, joints)),
        deviation=np.zeros((rows, 2, joints)),
        straight=np.zeros((rows, 2), dtype=bool),
        serial=np.zeros((rows, 2), dtype=np.int64),
        greatest=np.zeros(2),
        placed=np.zeros((2, 2), dtype=np.int64),
        part=np.zeros((rows, 2), dtype=np.int64),
        chosen=np.zeros(rows * max(pairs, 1), dtype=np.int64),
        wanted=np.zeros(bodies, dtype=bool),
        kept=np.zeros((2, VERTICES), dtype=np.int64),
        beside=np.zeros(VERTICES),
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
        stack.vertices[0, side] = 0
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
def lay_box(stack: Stack, row: int, side: int, tube: Tube) -> None:
    """Compute the box around the setpoints of a piece; the box of a divided span is kept."""
    if stack.window[row, side, 0] != _SPAN:
        start, end = _setpoints(stack, row, side, tube)
        points, half = tube.points[start:end], stack.half[row, side]
        write_box(points, stack.middle[row, side], half)
        for joint in range(points.shape[1]):
            half[joint] += beside(points, joint, tube.tolerance, tube.spread)


@inlined
def lay_span(stack: Stack, row: int, side: int, tube: Tube) -> None:
    """Compute the span of a piece within its box, unless it exists."""
    if stack.vertices[row, side] == 0:
        start, end = _setpoints(stack, row, side, tube)
        points, deviation = tube.points[start:end], stack.deviation[row, side]
        vertices = write_span(
            points,
            stack.middle[row, side],
            stack.offset[row, side],
            deviation,
            stack.kept,
            stack.beside,
            stack.aside,
        )
        stack.vertices[row, side] = vertices
        bent = 0.0
        for joint in range(points.shape[1]):
            width = beside(points, joint, tube.tolerance, tube.spread)
            bent = max(bent, deviation[joint], width - tube.tolerance[joint])
            deviation[joint] += width
        stack.straight[row, side] = vertices <= 2 and bent < SHORTEST


@inlined
def _setpoints(stack: Stack, row: int, side: int, tube: Tube) -> tuple[int, int]:
    """Which of a tube's setpoints are those of a piece's windows: the first, and the one behind the last."""
    first, last = stack.window[row, side, 0], stack.window[row, side, 1]
    return max(0, min(first - tube.lag, len(tube.points) - 1)), last + 1


@inlined
def divides(stack: Stack, row: int, side: int, tube: Tube) -> bool:
    """Whether a piece whose span is laid can be divided."""
    return _by_windows(stack, row, side, tube) or _by_length(stack, row, side, tube)


@inlined
def divide(stack: Stack, row: int, side: int, tube: Tube, serial: int) -> None:
    """Divide a piece: the second half goes to the next row, with the same piece of the other robot; the first stays.

    The halves get the number `serial` and the next.
    """
    stack.serial[row, side], stack.serial[row + 1, side] = serial, serial + 1
    stack.serial[row + 1, 1 - side] = stack.serial[row, 1 - side]
    for both in range(2):
        for k in range(2):
            stack.window[row + 1, both, k] = stack.window[row, both, k]
        stack.vertices[row + 1, both] = stack.vertices[row, both]
        stack.straight[row + 1, both] = stack.straight[row, both]
        for joint in range(stack.middle.shape[2]):
            stack.middle[row + 1, both, joint] = stack.middle[row, both, joint]
            stack.half[row + 1, both, joint] = stack.half[row, both, joint]
            stack.deviation[row + 1, both, joint] = stack.deviation[row, both, joint]
            for vertex in range(stack.vertices[row, both]):
                stack.offset[row + 1, both, vertex, joint] = stack.offset[row, both, vertex, joint]
    stack.part[row + 1, 0], stack.part[row + 1, 1] = stack.part[row, 0], stack.part[row, 1]
    if _by_windows(stack, row, side, tube):
        middle = (stack.window[row, side, 0] + stack.window[row, side, 1]) // 2
        stack.window[row, side, 1], stack.window[row + 1, side, 0] = middle, middle + 1
        stack.vertices[row, side] = stack.vertices[row + 1, side] = 0
        return
    one, other, _ = _longest(stack, row, side, tube.points.shape[1])
    for half in range(2):
        stack.window[row + half, side, 0] = _SPAN
        offset = stack.offset[row + half, side]
        for joint in range(tube.points.shape[1]):
            offset[other if half == 0 else one, joint] = (offset[one, joint] + offset[other, joint]) / 2.0
        centre(
            stack.middle[row + half, side],
            stack.half[row + half, side],
            offset,
            stack.vertices[row, side],
            stack.deviation[row, side],
            tube.points.shape[1],
        )


@inlined
def _by_windows(stack: Stack, row: int, side: int, tube: Tube) -> bool:
    """Whether a piece has several windows that are no straight line together."""
    first, last = stack.window[row, side, 0], stack.window[row, side, 1]
    return bool(len(tube.points) > 0 and first != _SPAN and first != last and not stack.straight[row, side])


@inlined
def _by_length(stack: Stack, row: int, side: int, tube: Tube) -> bool:
    joints = tube.points.shape[1]
    shortest = max(SHORTEST, _widest(stack.deviation[row, side], joints))
    return bool(len(tube.points) > 0 and _longest(stack, row, side, joints)[2] / 2.0 >= shortest)


@inlined
def _longest(stack: Stack, row: int, side: int, joints: int) -> tuple[int, int, float]:
    """The two vertices of a span that are farthest from one another, in the joint in which any are, and how far."""
    offset, one, other, most = stack.offset[row, side], 0, 0, 0.0
    for joint in range(joints):
        low = high = 0
        for vertex in range(1, stack.vertices[row, side]):
            if offset[vertex, joint] < offset[low, joint]:
                low = vertex
            if offset[vertex, joint] > offset[high, joint]:
                high = vertex
        if offset[high, joint] - offset[low, joint] > most:
            one, other, most = low, high, offset[high, joint] - offset[low, joint]
    return one, other, most


@inlined
def _widest(of: Array, joints: int) -> float:
    widest = 0.0
    for joint in range(joints):
        widest = max(widest, of[joint])
    return widest
