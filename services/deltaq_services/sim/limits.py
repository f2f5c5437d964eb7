"""I1 and I3: how much of a request fits between the joint limits, velocity and acceleration bounds.

A request is blended with the next step of the brake, `dq(s) = (1 - s) * brake + s * request`. The functions here
give the largest s in [0, 1] that keeps the bounds, and say which joint bound it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.messages import Reason
from deltaq_protocol.reasons import ReasonCode

_SCALES = np.linspace(0.0, 1.0, 129)
"""Scales tried where the length of the brake, a whole number of cycles, makes the bound no formula."""

_SLACK = 1e-9
"""Fraction of a bound by which rounding may exceed it."""


def shares_within(start: Array, end: Array, low: Array, high: Array) -> Array:
    """(n,) how far each joint may go from `start`, which lies between `low` and `high`, towards `end`; 1 is all."""
    change = end - start
    room = np.where(change > 0, high - start, low - start)
    with np.errstate(all="ignore"):
        shares: Array = np.where(change == 0, 1.0, room / change)
    return shares


def share_within(start: Array, end: Array, low: Array, high: Array) -> float:
    """How far all joints may go together, in [0, 1]."""
    return float(np.clip(np.min(shares_within(start, end, low, high)), 0.0, 1.0))


@dataclass(frozen=True)
class Limits:
    """Limits of one robot: positions, and increments and their change over one cycle, each (n,)."""

    joint_names: tuple[str, ...]
    lower: Array
    upper: Array
    max_dq: Array
    max_dv: Array
    cycle_s: float

    @classmethod
    def of(cls, description: RobotDescription, cycle_s: float) -> Limits:
        """Limits of a robot with sample time `cycle_s`."""
        return cls(
            description.joint_names,
            description.lower,
            description.upper,
            description.max_velocity * cycle_s,
            description.max_acceleration * cycle_s**2,
            cycle_s,
        )

    def dynamic_scale(self, brake: Array, request: Array, last_dq: Array) -> tuple[float, list[Reason]]:
        """Largest s within the velocity and acceleration limits (I3).

        Args:
            brake: (n,) next increment of the brake, which keeps the limits.
            request: (n,) increment asked for.
            last_dq: (n,) increment sent last.

        Returns:
            s, and the reason if s < 1.
        """
        slowest = np.maximum(-self.max_dq, last_dq - self.max_dv)
        fastest = np.minimum(self.max_dq, last_dq + self.max_dv)
        scales = shares_within(brake, request, slowest, fastest)
        if np.all(scales >= 1.0 - _SLACK):
            return 1.0, []
        joint = int(np.argmin(scales))
        bound = fastest[joint] if request[joint] > brake[joint] else slowest[joint]
        if abs(bound) >= self.max_dq[joint] * (1 - _SLACK):
            reason = Reason(
                code=ReasonCode.VELOCITY_LIMIT,
                what=self.joint_names[joint],
                value=float(abs(request[joint]) / self.cycle_s),
                bound=float(self.max_dq[joint] / self.cycle_s),
            )
        else:
            reason = Reason(
                code=ReasonCode.ACCELERATION_LIMIT,
                what=self.joint_names[joint],
                value=float(abs(request[joint] - last_dq[joint]) / self.cycle_s**2),
                bound=float(self.max_dv[joint] / self.cycle_s**2),
            )
        return max(0.0, float(scales[joint])), [reason]

    def slow_scale(self, brake: Array, request: Array, share: float) -> float:
        """Largest s that leaves every joint within a fraction of its velocity limit; 0 while the brake is faster."""
        allowed = share * self.max_dq
        if np.any(np.abs(brake) > allowed):
            return 0.0
        return share_within(brake, request, -allowed, allowed)

    def position_scale(
        self, brake: Array, request: Array, q_cmd: Array, at_most: float
    ) -> tuple[float, list[Reason]]:
        """Largest s <= `at_most` whose brake ends inside the position limits (I1).

        The path is a straight line, so it is enough to check the end of the brake. A joint that stands outside
        its limits may come back and may not go further out.

        Returns:
            s, and the reason if s < `at_most`.
        """
        scales = np.append(_SCALES[at_most > _SCALES], at_most)[::-1]
        dq = brake + scales[:, None] * (request - brake)
        cycles = np.ceil(np.max(np.abs(dq) / self.max_dv, axis=1) * (1 - _SLACK)).clip(min=1)
        ends = q_cmd + dq * ((cycles + 1) / 2)[:, None]
        beyond = np.maximum(ends - np.maximum(self.upper, q_cmd), np.minimum(self.lower, q_cmd) - ends)
        inside = np.all(beyond <= 1e-12, axis=1)
        if inside[0]:
            return at_most, []
        joint = int(np.argmax(beyond[0]))
        up = ends[0, joint] > q_cmd[joint]
        reason = Reason(
            code=ReasonCode.POSITION_LIMIT,
            what=self.joint_names[joint],
            value=float(ends[0, joint]),
            bound=float(self.upper[joint] if up else self.lower[joint]),
        )
        return (float(scales[int(np.argmax(inside))]) if inside.any() else 0.0), [reason]

    def brake_cycles(self, dq: Array) -> int:
        """Length of the brake that follows `dq`."""
        return brake_cycles(dq, self.max_dv)
