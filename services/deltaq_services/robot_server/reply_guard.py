"""The last check of a reply before it goes to the drives: it depends on no earlier decision.

Whatever else fails, the correction that a KRC is sent is a number, no further from the last one than a joint may
travel in one cycle, and inside the limits of all corrections.
"""

import math
from collections.abc import Sequence

_SLACK = 1.0 + 1e-6
_ROUNDING = 1e-9
"""Tolerance of the bounds: a setpoint is a sum of increments, and a correction a difference of sums [rad or m]."""


def reply_fault(
    correction: Sequence[float],
    last: Sequence[float],
    most: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
) -> str | None:
    """The fault of a correction with value and bound; None if it is permitted.

    A correction that lies outside its limits and comes nearer to them, or stays, is accepted: the last one can
    always be sent again.

    Args:
        correction: (n,) to be sent [rad or m].
        last: (n,) that was sent last.
        most: (n,) that a joint may travel in one cycle.
        lower: (n,) least correction.
        upper: (n,) greatest correction.
    """
    for joint, value in enumerate(correction):
        if not math.isfinite(value):
            return _words(joint, "is not finite", value, most[joint])
        if abs(value - last[joint]) > most[joint] * _SLACK:
            return _words(joint, "leaps", value - last[joint], most[joint])
        if value < min(lower[joint], last[joint]) - _ROUNDING:
            return _words(joint, "is below its limit", value, lower[joint])
        if value > max(upper[joint], last[joint]) + _ROUNDING:
            return _words(joint, "is above its limit", value, upper[joint])
    return None


def _words(joint: int, what: str, value: float, bound: float) -> str:
    return f"correction of joint {joint + 1} {what}: {value:.6g}, allowed {bound:.6g} (rad or m)"
