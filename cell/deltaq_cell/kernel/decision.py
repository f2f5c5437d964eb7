"""All that the gate certifies for one decision, in two calls: handing over arrays takes longer than most looks.

`deltaq_services.sim.certificate` says the first in plain words and `deltaq_services.sim.certificate` the second.
"""

from __future__ import annotations

from typing import NamedTuple

from deltaq_cell.compiled import copied, inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Findings, Integers, Pairs, Placed
from deltaq_cell.kernel.course import Course, lay_course
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
from deltaq_protocol.arrays import Array


class TubesCertified(NamedTuple):
    """Result of a certification.

    Attributes:
        holds: whether every pair keeps the requested distance anywhere in the tubes.
        left: remaining budget [searches].
        told: index of the pair with the least room, in the first look or in the failing one; -1 for none.
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
    """Certify that pairs keep `room_m` beyond their stop distance anywhere in two tubes, or in one.

    Args:
        cell: the fixed data of the cell.
        placed: working memory; afterwards only some bodies are placed.
        mine: tube of one robot.
        theirs: tube of another; without points, all pairs are of the one robot and what stands.
        pairs: of the cell, or some; every stop distance and `room_m` together are positive.
        asked: (k,) indices of the pairs to be certified; inactive ones are skipped.
        room_m: required clearance beyond the stop distance [m].
        budget: how many pairs may be searched in parts of the tubes and be followed by others.
        tells: whether the pair with the least room is asked for also where all have theirs.
        stack: working memory for pieces.
        found: receives the findings.
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
            told, travel_m, least_m, most_m = _keep_where(stack, row, tightest, pairs, found)
        elif not whole:
            budget -= searched
        whole = False
        open_end = _list_open(stack, found, first, last)
        if open_end == last:
            top -= 1
            continue
        # the one that travels further is divided first
        mine_divides = not too_near and divides(stack, row, MINE, mine)
        theirs_divides = not too_near and divides(stack, row, THEIRS, theirs)
        if budget < 0 or not (mine_divides or theirs_divides) or top == len(stack.part):
            told, travel_m, least_m, most_m = _keep_where(stack, row, tightest, pairs, found)
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
def _list_open(stack: Stack, found: Findings, first: int, last: int) -> int:
    """List the open pairs of a row after all of them; returns where they end."""
    end = last
    for k in range(first, last):
        if found.open[stack.chosen[k]]:
            stack.chosen[end] = stack.chosen[k]
            end += 1
    return end


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
def _keep_where(
    stack: Stack, row: int, tightest: int, pairs: Pairs, found: Findings
) -> tuple[int, float, float, float]:
    """Keep where a pair was found; returns the pair, its travel, and bounds of its room from below and above."""
    for side in range(2):
        for joint in range(stack.told.shape[1]):
            stack.told[side, joint] = stack.middle[row, side, joint]
    most_m = found.at_most_m[tightest] - found.travel_m[tightest] - pairs.stop_m[tightest]
    return tightest, found.travel_m[tightest], found.room_m[tightest], most_m


class Against(NamedTuple):
    """The bodies that a tube is checked against: structure and the robot itself, then each tube of each other robot.

    Attributes:
        points: (k, n) setpoints of all tubes, one tube after the other [rad or m].
        tubes: (tubes, 12) of each: where its points begin and end, its lag, first and last window, its robot's first
            and last joint, the same of its bodies, where its pairs begin and end, and the robot's number. Of the
            first, which is no other robot's, there are no points.
        tolerance: (tubes, joints) of each [rad or m].
        spread: (tubes,) of each [cycles].
    """

    points: Array
    tubes: Integers
    tolerance: Array
    spread: Array


class Told(NamedTuple):
    """The pair with the least room of each tube that a robot's was held against.

    Attributes:
        pair: (tubes,) its index; -1 where no pair was asked about.
        travel_m: (tubes,) how far its bodies travel together [m].
        least_m: (tubes,) bound of its room from below [m].
        most_m: (tubes,) and from above [m].
        middle: (tubes, 2, joints) of the pieces in which it was found [rad or m].
    """

    pair: Integers
    travel_m: Array
    least_m: Array
    most_m: Array
    middle: Array


class Suspected(NamedTuple):
    """Pairs at which certificates failed, those of one certificate after those of another.

    Attributes:
        pairs: their indices.
        end: (rounds + 1,) where those of each certificate end, the first zero.
        robot: (rounds,) number of the robot on the other side.
    """

    pairs: Integers
    end: Integers
    robot: Integers


@makes_no_array
def certify_all(
    cell: Anatomy,
    placed: Placed,
    mine: Tube,
    against: Against,
    pairs: Pairs,
    every: Integers,
    room_m: float,
    budget: int,
    tells: bool,
    stack: Stack,
    found: Findings,
    told: Told,
) -> tuple[int, int, bool, int, int]:
    """Certify that a robot keeps `room_m` beyond every stop distance in its whole tube.

    Args:
        cell: the fixed data of the cell.
        placed: working memory for placements.
        mine: the robot's tube.
        against: the bodies that the tube is checked against.
        pairs: all of the cell; every stop distance and `room_m` together are positive.
        every: (pairs,) their indices.
        room_m: required clearance beyond the stop distance [m].
        budget: of searches in parts of tubes, for all together.
        tells: whether `told` is asked for.
        stack: working memory for pieces.
        found: receives the findings.
        told: receives the tightest pair of each tube, up to the first failure.

    Returns:
        Which of `against.tubes` it fails at, -1 if it holds; what is left of the budget; and of where it fails whether
        a pair was too near at the middle, and where in `stack.chosen` the open pairs begin and end.
    """
    for number in range(len(against.tubes)):
        first, last = against.tubes[number, 9], against.tubes[number, 10]
        theirs = _tube(against, number)
        verdict = certify(
            cell, placed, mine, theirs, pairs, every[first:last], room_m, budget, tells, stack, found
        )
        budget = verdict.left
        if tells:
            _tell(told, number, verdict, stack)
        if not verdict.holds:
            return number, budget, verdict.too_near, verdict.first_open, verdict.last_open
    return NONE, budget, False, 0, 0


@makes_no_array
def largest_share(
    cell: Anatomy,
    placed: Placed,
    course: Course,
    refused: float,
    against: Against,
    pairs: Pairs,
    every: Integers,
    room_m: float,
    budget: int,
    trial_budget: int,
    halvings: int,
    rounds: int,
    tells: bool,
    suspected: Suspected,
    stack: Stack,
    found: Findings,
    told: Told,
) -> tuple[float, int]:
    """Largest certified share of a request that the search finds, as in `deltaq_services.sim.certificate`.

    Beyond what `certify_all` takes, which does not write to `told` here:

    - course: memory for the trajectory of the request; overwritten.
    - refused: a share whose certificate does not hold.
    - trial_budget: of the budget, what one trial of suspects may spend on one other tube.
    - halvings: how finely a share is searched.
    - rounds: searches that end with a certificate.
    - tells: False. It is handed over because numba compiles `certify` once more for a constant, in a minute.
    - suspected: has the pairs at which the certificate of `refused` failed; is written to.

    Returns:
        The share, 0 if none is found, and what is left of the budget.
    """
    least = refused / 2**halvings
    # each call is in this text once: that of a large function takes seconds to compile
    for sets in range(1, rounds + 2):
        share = least
        if sets <= rounds:
            share, budget = _largest_kept(
                cell,
                placed,
                course,
                least,
                refused,
                against,
                pairs,
                room_m,
                budget,
                trial_budget,
                sets,
                tells,
                suspected,
                stack,
                found,
            )
        if share == 0.0:
            break
        mine = lay_course(course, share)
        failed, budget, _, first, last = certify_all(
            cell, placed, mine, against, pairs, every, room_m, budget, tells, stack, found, told
        )
        if failed == NONE:
            return share, budget
        if share == least:
            break
        refused = share
        if sets < rounds:
            _suspect(suspected, sets, stack.chosen[first:last], against.tubes[failed, 11])
    return 0.0, budget


@copied
def _largest_kept(
    cell: Anatomy,
    placed: Placed,
    course: Course,
    least: float,
    refused: float,
    against: Against,
    pairs: Pairs,
    room_m: float,
    budget: int,
    trial_budget: int,
    sets: int,
    tells: bool,
    suspected: Suspected,
    stack: Stack,
    found: Findings,
) -> tuple[float, int]:
    """Largest share below `refused` found at which the suspects keep apart, 0 if none; and the remaining budget.

    The least is tried first: where a robot stands right before an obstacle it is refused, and nearly always all others.
    """
    share, step, tried = 0.0, refused - least, least
    while True:
        kept, budget = _keep(
            cell,
            placed,
            course,
            tried,
            against,
            pairs,
            room_m,
            budget,
            trial_budget,
            sets,
            tells,
            suspected,
            stack,
            found,
        )
        if kept:
            share = tried
        if share == 0.0 or step <= least:
            return share, budget
        step /= 2
        tried = share + step


@copied
def _keep(
    cell: Anatomy,
    placed: Placed,
    course: Course,
    share: float,
    against: Against,
    pairs: Pairs,
    room_m: float,
    budget: int,
    trial_budget: int,
    sets: int,
    tells: bool,
    suspected: Suspected,
    stack: Stack,
    found: Findings,
) -> tuple[bool, int]:
    """Whether the suspects keep apart at a share, and the remaining budget."""
    mine = lay_course(course, share)
    for one in range(sets):
        asked = suspected.pairs[suspected.end[one] : suspected.end[one + 1]]
        for number in range(len(against.tubes)):
            if against.tubes[number, 11] != suspected.robot[one]:
                continue
            theirs = _tube(against, number)
            given = min(budget, trial_budget)
            verdict = certify(cell, placed, mine, theirs, pairs, asked, room_m, given, tells, stack, found)
            budget -= given - verdict.left
            if not verdict.holds:
                return False, budget
    return True, budget


@makes_no_array
def _tube(against: Against, number: int) -> Tube:
    of = against.tubes[number]
    points, tolerance = against.points[of[0] : of[1]], against.tolerance[number]
    return Tube(
        points, of[2], of[3], of[4], tolerance, against.spread[number], (of[5], of[6]), (of[7], of[8])
    )


@makes_no_array
def _tell(told: Told, number: int, verdict: TubesCertified, stack: Stack) -> None:
    told.pair[number], told.travel_m[number] = verdict.told, verdict.travel_m
    told.least_m[number], told.most_m[number] = verdict.least_m, verdict.most_m
    for side in range(2):
        for joint in range(stack.told.shape[1]):
            told.middle[number, side, joint] = stack.told[side, joint]


@makes_no_array
def _suspect(suspected: Suspected, sets: int, open_: Integers, robot: int) -> None:
    """Add the pairs at which a certificate failed to `sets` sets of them."""
    end = suspected.end[sets]
    for k in range(len(open_)):
        suspected.pairs[end + k] = open_[k]
    suspected.end[sets + 1], suspected.robot[sets] = end + len(open_), robot
