"""The brake: increments that bring a robot to rest along a straight line in joint space.

An admitted increment `dq` is followed by `dq * (N - k) / N` for k = 1 ... N, the last of which is zero. N is
the least number of cycles for which no joint exceeds its deceleration limit. Gate and Robot Server use
these same functions, so that both know to the bit which setpoints are sent when nothing arrives.
"""

import math

import numpy as np

from deltaq_protocol.arrays import Array

_ROUNDING = 1e-9
"""Relative slack below which a quotient counts as the whole number beneath it."""


def brake_cycles(dq: Array, max_dv: Array) -> int:
    """Least number of cycles in which `dq` can be braked.

    Args:
        dq: (n,) increment of one cycle [rad or m].
        max_dv: (n,) largest change of the increment between two cycles, `max_acceleration * cycle_s**2`.

    Returns:
        N >= 1 with `|dq| / N <= max_dv` for every joint.
    """
    return max(1, math.ceil(float((np.abs(dq) / max_dv).max()) * (1.0 - _ROUNDING)))


def brake_increment(dq: Array, cycles: int, step: int) -> Array:
    """Increment of brake step `step` after `dq`: step 0 is `dq` itself, from step `cycles` on it is zero."""
    if step >= cycles:
        return np.zeros_like(dq)
    return dq * ((cycles - step) / cycles)


def brake_travel(dq: Array, cycles: int, step: int) -> Array:
    """Sum of all increments still to come after brake step `step` has been sent.

    From the arithmetic series `sum((N - k) / N for k in step + 1 ... N)`.
    """
    left = max(0, cycles - step)
    return dq * (left * (left - 1) / (2 * cycles))
