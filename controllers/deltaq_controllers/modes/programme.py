"""One quadratic programme per cycle: the joints' increment, the pace of the tasks, and each task's shortfall.

    minimise    rest |D (dq - drift)|^2  +  |w T|^2 (1 - pace)^2  +  line |e|^2  +  price . s
    subject to  R dq = pace w T + back + e                 the tasks
                slowest <= dq <= fastest                   position, speed, acceleration, jerk
                approach_down - s <= dq <= approach_up + s  limits ahead
                C dq + s >= c,  s >= 0                      clearance
                0 <= pace <= most

R are the tasks' rows, w their desired rates, `back` their correction of earlier errors. The weights lie so far apart
that they act as an order: first the lines of the tasks, then clearance, then room before limits, then the pace along
the lines, and in the null space of all of these the joints' drift. Where a constraint is active, the pace is reduced
and the lines are kept.

Every weight is alone on the diagonal of the cost, so widely different weights cause no rounding errors. The solver is
DAQP's dual active-set method (Arnström, Bemporad and Axehill, 2022, IEEE TAC 67(8)), started cold in each cycle: the
same view gives the same increment, bit for bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.surroundings.barriers import Barriers
from deltaq_protocol.arrays import Array, Indices

# Bounds of an increment: position, speed and acceleration; and narrower preferred bounds.
#
# The gate follows every increment by a straight brake of all joints together, as many cycles long as the joint needs
# that takes longest. So a joint that speeds up takes room away from all joints near their limits. The box therefore
# also bounds the length of the next brake: it may grow by a cycle only if every joint has room for that. The gate
# admits every increment in the box, and the present brake, which keeps the hands on their line, is always in it.
#
# Before its limit a joint should slow down by itself, early enough for others to take over, and its acceleration
# should change by no more than the jerk. Both are preferences within the box: if only the whole arm can slow down,
# it does.


APPROACH_S = 0.2
"""Least time in which a joint may use up its distance to a limit [s]."""

ACCELERATION, SPEED, POSITION = range(3)
"""What a bound comes from; one of acceleration or jerk passes."""

_STILL = 1e-9
"""A joint with a smaller increment stands, and needs no room [rad or m]."""

_SHY = 1.0 - 1e-9
"""Fraction of a brake's cycles that a joint uses, so that rounding does not make it a cycle longer."""


class Box(NamedTuple):
    """Bounds of an increment.

    Attributes:
        slowest: (n,) least increment [rad or m].
        fastest: (n,) greatest increment [rad or m].
        approach_down: (n,) least preferred increment, above `slowest` [rad or m].
        approach_up: (n,) greatest preferred increment, below `fastest` [rad or m].
        why_slowest: (n,) cause of each least increment.
        why_fastest: (n,) cause of each greatest increment.
    """

    slowest: Array
    fastest: Array
    approach_down: Array
    approach_up: Array
    why_slowest: NDArray[np.intp]
    why_fastest: NDArray[np.intp]


@compiled
def increment_box(
    limits: IncrementLimits,
    q: Array,
    dq_last: Array,
    dq_before: Array,
    cycles: int,
    max_jerk: Array,
    cycle_s: float,
) -> Box:
    """The box of the next increment.

    Args:
        limits: of the increments.
        q: (n,) configuration [rad or m].
        dq_last: (n,) increment that led to it [rad or m].
        dq_before: (n,) the one before that [rad or m].
        cycles: how many the brake of `dq_last` takes.
        max_jerk: (n,) greatest change of the increment's change [rad or m].
        cycle_s: the cycle [s].
    """
    n = len(q)
    brake = dq_last * ((cycles - 1) / cycles)
    most = next_brake(limits, q, brake, cycles)
    slowest, fastest, down, up = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    why_slowest, why_fastest = np.empty(n, dtype=np.intp), np.empty(n, dtype=np.intp)
    for joint in range(n):
        low, high = limits.lower[joint] - q[joint], limits.upper[joint] - q[joint]
        even = 2.0 * dq_last[joint] - dq_before[joint]
        for sense, room in ((-1.0, -low), (1.0, high)):
            last, stopping = sense * dq_last[joint], sense * brake[joint]
            swift = min(limits.max_dq[joint], most * _SHY * limits.max_ddq[joint])
            bound, why = swift, SPEED
            if last + limits.max_ddq[joint] < bound:
                bound, why = last + limits.max_ddq[joint], ACCELERATION
            if 2.0 / (most + 1) * room < bound:
                bound, why = 2.0 / (most + 1) * room, POSITION
            bound = max(bound, stopping)
            # as far as it can slow down by itself
            wish = max(cycle_s / APPROACH_S * room, last - limits.max_ddq[joint], 0.0)
            if wish <= bound:
                bound_of_wish, why = wish, POSITION
            else:
                bound_of_wish = bound
            if sense * even + max_jerk[joint] < bound_of_wish:
                bound_of_wish, why = sense * even + max_jerk[joint], ACCELERATION
            wish = bound_of_wish
            if sense < 0.0:
                slowest[joint], down[joint], why_slowest[joint] = -bound, -wish, why
            else:
                fastest[joint], up[joint], why_fastest[joint] = bound, wish, why
    return Box(slowest, fastest, down, up, why_slowest, why_fastest)


@compiled
def next_brake(limits: IncrementLimits, q: Array, brake: Array, cycles: int) -> int:
    """How many cycles the next brake may take: one more, as many, or one less than the present one."""
    for most in (cycles + 1, cycles):
        room, has_room = 2.0 / (most + 1), True
        for joint in range(len(q)):
            step = brake[joint]
            if (step > _STILL and step > room * (limits.upper[joint] - q[joint])) or (
                step < -_STILL and step < room * (limits.lower[joint] - q[joint])
            ):
                has_room = False
        if has_room:
            return most
    return cycles - 1


@compiled
def admits(limits: IncrementLimits, q: Array, dq: Array, dq_last: Array) -> bool:
    """Whether an increment is admissible: `IncrementLimits.admissible` would return it unchanged.

    Args:
        limits: of the increments.
        q: (n,) setpoint that it is added to [rad or m].
        dq: (n,) increment [rad or m].
        dq_last: (n,) increment that led to the setpoint [rad or m].
    """
    longest = 1.0
    for joint in range(len(q)):
        slowest = max(dq_last[joint] - limits.max_ddq[joint], -limits.max_dq[joint])
        fastest = min(dq_last[joint] + limits.max_ddq[joint], limits.max_dq[joint])
        if dq[joint] < min(slowest, fastest) or dq[joint] > max(slowest, fastest):
            return False
        longest = max(longest, abs(dq[joint]) / limits.max_ddq[joint])
    reach = 0.5 * (math.ceil(longest) + 1)
    for joint in range(len(q)):
        end = q[joint] + reach * dq[joint]
        if end > limits.upper[joint] or end < limits.lower[joint]:
            return False
    return True


@compiled
def can_rest(box: Box, dq_last: Array, max_jerk: Array) -> bool:
    """Whether all joints may be at rest in the next cycle, and in the one after it."""
    for joint in range(len(dq_last)):
        low = max(box.slowest[joint], box.approach_down[joint])
        high = min(box.fastest[joint], box.approach_up[joint])
        if low > 0.0 or high < 0.0 or abs(dq_last[joint]) > max_jerk[joint]:
            return False
    return True


REST = 1e-5
"""Cost of a squared mrad of a joint, where a squared mm of lost way along the line costs one."""

LINE = 1e5
"""Cost of a squared mm off the line."""

APPROACH = 1e1
"""Cost of a mrad by which a joint approaches its limit faster than preferred."""

CLEARANCE = 1e2
"""Cost of a mm that is missing from a clearance."""

_SLACKS = 3
"""One for each kind of barrier, so that slack of one kind does not loosen the others."""

_MILLI = 1e3
"""The programme counts in mm and mrad, so that its numbers are near one."""

_UNBOUNDED = 1e30
"""The solver's value for no bound."""

_EQUATION = 5
"""The solver's code for an equality constraint."""

_LEAST_WAY_MM = 1e-3
"""Least travel of a task in a cycle by which it is weighed."""

_NO_RATE_M_S = 1e-12
"""Tasks that go no faster stand."""


class Wanted(NamedTuple):
    """The requested motion of the tasks in a cycle.

    Attributes:
        rows: (r, n) displacement of each task per joint displacement, turns as travel [m/rad].
        rates: (r,) requested rate of each task [m/s].
        made: (r,) rate in the last cycle, at which a task may go on though less is requested [m/s].
        back: (r,) earlier error to be corrected as well [m].
        cycle_s: sampling time [s].
    """

    rows: Array
    rates: Array
    made: Array
    back: Array
    cycle_s: float


class Drift(NamedTuple):
    """The motion of the joints without tasks.

    Attributes:
        dq: (n,) increment [rad or m].
        weights: (n,) cost of the squared difference from it.
    """

    dq: Array
    weights: Array


class Solution(NamedTuple):
    """The answer.

    Attributes:
        dq: (n,) increment, within its bounds [rad or m].
        pace: of the tasks along their way.
        off_line: error of all tasks together [m].
        joint_forces: (n,) how hard the bound of each joint presses, positive at `fastest`.
        barrier_forces: (k,) how hard each barrier presses.
    """

    dq: Array
    pace: float
    off_line: float
    joint_forces: Array
    barrier_forces: Array


def solve(wanted: Wanted, box: Box, drift: Drift, barriers: Barriers) -> Solution | None:
    """Solve the programme; None if the solver found no answer."""
    written = _written(wanted, box, drift, barriers)
    hessian, linear, rows, low, high, kinds, approaching, senses = written
    solution, _, found, told = daqp.solve(hessian, linear, rows, high, low, kinds)
    if found != 1:
        return None
    forces = np.asarray(told["lam"])
    pairs = len(barriers.least)
    answer = _answered(np.asarray(solution), forces, box, approaching, senses, len(wanted.rates), pairs)
    # rounding may make it inconsistent
    return answer if math.isfinite(answer.off_line) else None


@compiled
def _answered(
    solution: Array, forces: Array, box: Box, approaching: Indices, senses: Array, tasks: int, pairs: int
) -> Solution:
    """The answer that the solver's numbers stand for; `off_line` is not finite if one of them is not."""
    n = len(box.slowest)
    dq, joint_forces = np.empty(n), forces[:n].copy()
    for joint in range(n):
        dq[joint] = min(max(solution[joint] / _MILLI, box.slowest[joint]), box.fastest[joint])
    first = len(solution) + tasks
    for wish in range(len(approaching)):
        joint_forces[approaching[wish]] += abs(forces[first + pairs + wish]) * senses[wish]
    square = 0.0
    for error in solution[n + 1 : n + 1 + tasks]:
        square += error * error
    off_line = math.sqrt(square) / _MILLI if np.isfinite(solution).all() else math.nan
    return Solution(dq, solution[n], off_line, joint_forces, np.abs(forces[first : first + pairs]))


@compiled
def _approaching(box: Box) -> tuple[Indices, Array]:
    """The joints with a preferred bound inside their hard one, and its side, -1 or 1."""
    n = len(box.slowest)
    joints, senses, count = np.empty(2 * n, dtype=np.intp), np.empty(2 * n), 0
    for joint in range(n):
        if box.approach_down[joint] > box.slowest[joint]:
            joints[count], senses[count] = joint, -1.0
            count += 1
        if box.approach_up[joint] < box.fastest[joint]:
            joints[count], senses[count] = joint, 1.0
            count += 1
    return joints[:count], senses[:count]


@compiled
def _written(
    wanted: Wanted, box: Box, drift: Drift, barriers: Barriers
) -> tuple[Array, Array, Array, Array, Array, NDArray[np.int32], Indices, Array]:
    """The programme in the solver's form: over the increment, the pace, the tasks' errors and the slacks.

    Returns:
        Cost, its linear part, rows, lower and upper bounds, kinds of the constraints, and what `_approaching` says.
    """
    tasks, n = wanted.rows.shape
    approaching, senses = _approaching(box)
    pairs, wishes = len(barriers.least), len(approaching)
    slacks = n + 1 + tasks
    count = slacks + _SLACKS + wishes
    hessian, linear = np.zeros((count, count)), np.zeros(count)
    rows = np.zeros((tasks + pairs + wishes, count))
    low = np.full(count + len(rows), -_UNBOUNDED)
    high = np.full(count + len(rows), _UNBOUNDED)
    kinds = np.zeros(count + len(rows), dtype=np.int32)
    for joint in range(n):
        hessian[joint, joint] = REST * drift.weights[joint]
        linear[joint] = -REST * drift.weights[joint] * _MILLI * drift.dq[joint]
        low[joint], high[joint] = _MILLI * box.slowest[joint], _MILLI * box.fastest[joint]
    size = math.sqrt((wanted.rates * wanted.rates).sum())
    hessian[n, n] = max(_MILLI * wanted.cycle_s * size, _LEAST_WAY_MM) ** 2
    linear[n] = -hessian[n, n]
    low[n], high[n] = 0.0, 1.0
    if size > _NO_RATE_M_S:
        high[n] = max(1.0, math.sqrt((wanted.made * wanted.made).sum()) / size)
    for task in range(tasks):
        hessian[n + 1 + task, n + 1 + task] = LINE
        rows[task, :n] = wanted.rows[task]
        rows[task, n] = -_MILLI * wanted.cycle_s * wanted.rates[task]
        rows[task, n + 1 + task] = -1.0
        low[count + task] = high[count + task] = _MILLI * wanted.back[task]
        kinds[count + task] = _EQUATION
    for slack in range(slacks, count):
        # the slacks' own squares keep the programme strictly convex
        hessian[slack, slack], low[slack] = 1e-3, 0.0
        linear[slack] = CLEARANCE if slack < slacks + _SLACKS else APPROACH
    for pair in range(pairs):
        row = tasks + pair
        rows[row, :n] = barriers.rows[pair]
        rows[row, slacks + barriers.kinds[pair]] = 1.0
        low[count + row] = _MILLI * barriers.least[pair]
    for wish in range(wishes):
        row, joint = tasks + pairs + wish, approaching[wish]
        rows[row, joint] = -senses[wish]
        rows[row, slacks + _SLACKS + wish] = 1.0
        bound = box.approach_up[joint] if senses[wish] > 0.0 else box.approach_down[joint]
        low[count + row] = -_MILLI * senses[wish] * bound
    return hessian, linear, rows, low, high, kinds, approaching, senses
