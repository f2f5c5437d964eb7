"""The box that an increment stays in: position, speed and acceleration, and within them the jerk."""

from __future__ import annotations

from deltaq_cell.compiled import compiled
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.surroundings.barriers import bounds
from deltaq_protocol.arrays import Array


@compiled
def bounds_with_jerk(
    limits: IncrementLimits, q: Array, dq_last: Array, dq_before: Array, cycles: int, max_jerk: Array
) -> tuple[Array, Array]:
    """Least and greatest increment (n,).

    The limits go first: a joint that has to brake before one does so at once, whatever the jerk.

    Args:
        limits: of the increments.
        q: (n,) configuration [rad or m].
        dq_last: (n,) increment that led to it [rad or m].
        dq_before: (n,) the one before that [rad or m].
        cycles: how many the brake of `dq_last` takes.
        max_jerk: (n,) greatest change of the increment's change [rad or m].
    """
    slowest, fastest = bounds(limits, q, dq_last, cycles)
    for joint in range(len(q)):
        even = 2.0 * dq_last[joint] - dq_before[joint]
        low, high = even - max_jerk[joint], even + max_jerk[joint]
        if high < slowest[joint]:
            fastest[joint] = min(fastest[joint], slowest[joint] + max_jerk[joint])
        elif low > fastest[joint]:
            slowest[joint] = max(slowest[joint], fastest[joint] - max_jerk[joint])
        else:
            slowest[joint], fastest[joint] = max(slowest[joint], low), min(fastest[joint], high)
    return slowest, fastest
