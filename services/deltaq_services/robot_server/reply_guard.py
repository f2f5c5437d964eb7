"""The last check of a reply before it goes to the drives: it depends on no earlier decision.

Whatever else fails, the correction that a KRC is sent is a number, no further from the last one than a joint may
travel in one cycle, and inside the limits of all corrections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

_SLACK = 1.0 + 1e-6
_ROUNDING = 1e-9
"""Tolerance of the bounds: a setpoint is a sum of increments, and a correction a difference of sums [rad or m]."""


@dataclass(frozen=True, slots=True)
class ReplyFault:
    """Why a correction must not be sent: joint, fault, value and bound [rad or m]."""

    joint: int
    what: Literal["is not finite", "leaps", "is below its limit", "is above its limit"]
    value: float
    bound: float

    def __str__(self) -> str:
        value, bound = f"{self.value:.6g}", f"{self.bound:.6g}"
        return f"correction of joint {self.joint + 1} {self.what}: {value}, allowed {bound} (rad or m)"


def reply_fault(
    correction: Sequence[float],
    last: Sequence[float],
    most: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
) -> ReplyFault | None:
    """The fault of a correction; None if it is permitted.

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
            return ReplyFault(joint, "is not finite", value, most[joint])
        if abs(value - last[joint]) > most[joint] * _SLACK:
            return ReplyFault(joint, "leaps", value - last[joint], most[joint])
        if value < min(lower[joint], last[joint]) - _ROUNDING:
            return ReplyFault(joint, "is below its limit", value, lower[joint])
        if value > max(upper[joint], last[joint]) + _ROUNDING:
            return ReplyFault(joint, "is above its limit", value, upper[joint])
    return None
