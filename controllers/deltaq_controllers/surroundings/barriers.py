"""The constraints of the quadratic programmes, compiled: bounds of the joints, and barriers of the distances.

Both are judged at the end of the brake with which the gate follows every increment.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.surroundings.neighbours import NearPairs
from deltaq_protocol.arrays import Array

_BRAKING = 0.98
"""Fraction of its deceleration with which a joint stops at a limit; the rest leaves the solver room between bounds."""

OTHERS, STANDING, RESERVE = range(3)
"""Kinds of barriers, by their slack."""


class Keeping(NamedTuple):
    """How distances are kept, by pair of bodies.

    Attributes:
        foreign: (p,) whether the pair's other body belongs to another robot.
        margins: (p,) least distance, however they move [m].
        shares: (p,) part of the remaining distance that one cycle may use up.
        reaction_s: time for which another robot is expected to keep its speed [s].
        others_brake_m_s2: deceleration that is expected of another robot [m/s^2].
    """

    foreign: NDArray[np.bool_]
    margins: Array
    shares: Array
    reaction_s: float
    others_brake_m_s2: float


class Braking(NamedTuple):
    """The rest of the present brake, `travel` (n,), and by how many increments a new one moves its end."""

    travel: Array
    reach: float


class Barriers(NamedTuple):
    """`rows dq >= least`, up to a slack of each kind.

    Attributes:
        rows: (k, n) change of each distance per increment.
        least: (k,) least change [m].
        kinds: (k,) whose slack it may use.
        places: (k,) which of the near pairs each is of.
    """

    rows: Array
    least: Array
    kinds: NDArray[np.intp]
    places: NDArray[np.intp]


@compiled
def barriers_of(
    near: NearPairs,
    keeping: Keeping,
    braking: Braking,
    rates: Array,
    slowest: Array,
    fastest: Array,
    cycle_s: float,
) -> Barriers:
    """A barrier for each distance in range, except those that no increment within its bounds can break.

    Other robots have two: the distance to be kept, and their braking distance in addition. The second
    gives way to the view, since the gate stops them.

    Args:
        near: the near bodies at the end of the present brake.
        keeping: how distances are kept.
        braking: the brake.
        rates: (m,) rates of all joints of the cell, the own ones zero [rad/s or m/s].
        slowest: (n,) least increment [rad or m].
        fastest: (n,) greatest increment [rad or m].
        cycle_s: the cycle [s].
    """
    most, n = 2 * len(near.pairs), near.own.shape[1]
    rows, least = np.empty((most, n)), np.empty(most)
    kinds, places = np.empty(most, dtype=np.intp), np.empty(most, dtype=np.intp)
    k = 0
    for i in range(len(near.pairs)):
        pair, row = near.pairs[i], near.own[i]
        closing = max(-(near.others[i] * rates).sum(), 0.0)
        share, travel = keeping.shares[pair], (row * braking.travel).sum()
        change = closing * cycle_s - share * (near.distance[i] - keeping.margins[pair])
        needed = closing * (keeping.reaction_s + closing / (2.0 * keeping.others_brake_m_s2))
        at_worst = np.minimum(row * slowest, row * fastest).sum()
        first = OTHERS if keeping.foreign[pair] else STANDING
        for kind, more in ((first, 0.0), (RESERVE, share * needed)):
            wanted = (change + travel + more) / braking.reach
            if at_worst < wanted and (kind != RESERVE or more > 0.0):
                rows[k], least[k], kinds[k], places[k] = row, wanted, kind, i
                k += 1
    return Barriers(rows[:k], least[:k], kinds[:k], places[:k])


@compiled
def bounds(limits: IncrementLimits, q: Array, dq_last: Array, cycles: int) -> tuple[Array, Array]:
    """Least and greatest increment (n,) of speed, acceleration and room to brake.

    Args:
        limits: of the increments.
        q: (n,) configuration [rad or m].
        dq_last: (n,) increment that led to it [rad or m].
        cycles: how many its brake takes.
    """
    slowest = np.maximum(dq_last - limits.max_ddq, -limits.max_dq)
    fastest = np.minimum(dq_last + limits.max_ddq, limits.max_dq)
    # the brake after the increment is at most a cycle longer than the one before it; two cycles more, and a joint
    # can slow down by itself before its limit while others speed up: too late, and the whole arm has to brake
    room = 2.0 / (cycles + 4)
    hardest = _BRAKING * limits.max_ddq
    # a joint that exceeds its speed limit has both bounds on the same side
    least = np.maximum(np.minimum(slowest, fastest), room * (limits.lower - q))
    most = np.minimum(np.maximum(slowest, fastest), room * (limits.upper - q))
    return np.minimum(least, dq_last + hardest), np.maximum(most, dq_last - hardest)


_AT_LIMIT = 0.01
"""A joint this near to a limit is at it [rad or m]."""


def bounds_met(
    robot: RobotModel,
    q: Array,
    dq: Array,
    barriers: Barriers,
    near: NearPairs,
    names: Sequence[tuple[str, str]],
) -> tuple[str, ...]:
    """The bounds that hold an arm back: its joints at a limit, and pairs of bodies whose barrier leaves no room.

    Args:
        robot: the robot.
        q: (n,) its setpoint [rad or m].
        dq: (n,) its next increment [rad or m].
        barriers: of the distances of the `near` pairs.
        near: those pairs.
        names: of the bodies of each pair.

    Returns:
        Bounds for people, such as `a3 at its upper limit` or `fr/link_2 near fr/camera`.
    """
    met = []
    for joint, at, lower, upper in zip(
        robot.description.joint_names, q, robot.lower, robot.upper, strict=True
    ):
        if at > upper - _AT_LIMIT or at < lower + _AT_LIMIT:
            met.append(f"{joint} at its {'upper' if at > upper - _AT_LIMIT else 'lower'} limit")
    is_tight = (barriers.rows @ dq <= barriers.least + 1e-9) & (barriers.kinds != RESERVE)
    tight = (names[near.pairs[place]] for place in barriers.places[is_tight])
    return tuple(dict.fromkeys([*met, *(f"{one} near {other}" for one, other in tight)]))
