"""The box that an increment stays in: position, speed and acceleration; and what is wished for within it.

The gate follows every increment by a straight brake of all joints together, as many cycles long as the joint needs that
takes longest. So a joint that speeds up takes room away from all joints near their limits. The box therefore bounds
the length of the next brake too: it may grow by a cycle only where every joint has the room for that. Whatever is in
the box the gate admits, and the present brake, which keeps the hands on their line, is always in it.

Before its limit a joint is to slow down by itself, so slowly that others can take over its work, and its acceleration
is to change by no more than the jerk. Both are wishes within the box: where only the whole arm can slow down, it does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_controllers.limits import IncrementLimits
from deltaq_protocol.arrays import Array

APPROACH_S = 0.2
"""Time in which a joint uses up what is left to its limit, at least [s]."""

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
        approach_down: (n,) least increment that is wished for, above `slowest` [rad or m].
        approach_up: (n,) greatest increment that is wished for, below `fastest` [rad or m].
        why_slowest: (n,) what the least increment comes from.
        why_fastest: (n,) what the greatest comes from.
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
    """Whether an increment is admissible as it is: `IncrementLimits.admissible` would give it back.

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
    """Whether all joints may stand in the next cycle, and stay so in the one after it."""
    for joint in range(len(dq_last)):
        low = max(box.slowest[joint], box.approach_down[joint])
        high = min(box.fastest[joint], box.approach_up[joint])
        if low > 0.0 or high < 0.0 or abs(dq_last[joint]) > max_jerk[joint]:
            return False
    return True
