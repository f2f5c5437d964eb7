"""I1 and I3: how much of a request fits between the joint limits, velocity and acceleration bounds.

A request is blended with the next step of the brake, `dq(s) = (1 - s) * brake + s * request`. The functions here
give the largest s in [0, 1] that keeps the bounds, and say which joint bound it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_cell.kernel.course import keeps_limits
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.messages import MOST, Reason
from deltaq_protocol.reasons import ReasonCode

_SCALES = np.linspace(0.0, 1.0, 129)
"""Scales tried where the length of the brake, a whole number of cycles, makes the bound no formula."""

_ROUNDING = 1e-12
"""How far beyond a position limit a sum of increments may end [rad or m]."""

_SLACK = 1e-9
"""Fraction of a bound by which rounding may exceed it."""


def shares_within(start: Array, end: Array, low: Array, high: Array) -> list[float]:
    """Greatest fraction of the step from `start` to `end` that each joint's bounds allow; may exceed 1."""
    shares = []
    # of so few numbers, arrays take several times as long
    for here, there, least, most in np.array([start, end, low, high]).T.tolist():
        change = there - here
        room = (most if change > 0 else least) - here
        shares.append(1.0 if change == 0 else room / change)
    return shares


def share_within(start: Array, end: Array, low: Array, high: Array) -> float:
    """How far all joints may go together, in [0, 1]."""
    return min(max(min(shares_within(start, end, low, high)), 0.0), 1.0)


def _rate(change: float, over: float) -> float:
    """`|change| / over`, clipped to the greatest number of a message."""
    return float(min(abs(change), MOST * over) / over)


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
            np.array(description.lower),
            np.array(description.upper),
            description.max_velocity * cycle_s,
            description.max_acceleration * cycle_s**2,
            cycle_s,
        )

    def scale(self, brake: Array, request: Array, last_dq: Array, q_cmd: Array) -> tuple[float, list[Reason]]:
        """Largest s within all limits (I1 and I3), and the tightest one's reason if s < 1; arguments as for `keeps`."""
        if self.keeps(brake, request, last_dq, q_cmd):
            return 1.0, []
        scale, reasons = self.dynamic_scale(brake, request, last_dq)
        if self.keeps(brake, request, last_dq, q_cmd, scale):
            return scale, reasons
        scale, tighter = self.position_scale(brake, request, q_cmd, scale)
        return scale, tighter or reasons

    def keeps(self, brake: Array, request: Array, last_dq: Array, q_cmd: Array, share: float = 1.0) -> bool:
        """Whether a share of a request is within all limits, as nearly every whole one is.

        Args:
            brake: (n,) next increment of the brake.
            request: (n,) increment asked for.
            last_dq: (n,) increment sent last.
            q_cmd: (n,) setpoint.
            share: 0 for the brake, 1 for the whole request.
        """
        bounds = self.max_dq, self.max_dv, self.lower, self.upper
        return bool(keeps_limits(brake, request, share, last_dq, q_cmd, *bounds, _SLACK, _ROUNDING))

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
        shares = shares_within(brake, request, slowest, fastest)
        scale = min(shares)
        if scale >= 1.0 - _SLACK:
            return 1.0, []
        joint = shares.index(scale)
        bound = fastest[joint] if request[joint] > brake[joint] else slowest[joint]
        if abs(bound) >= self.max_dq[joint] * (1 - _SLACK):
            reason = Reason(
                code=ReasonCode.VELOCITY_LIMIT,
                what=self.joint_names[joint],
                value=_rate(request[joint], self.cycle_s),
                bound=float(self.max_dq[joint] / self.cycle_s),
            )
        else:
            reason = Reason(
                code=ReasonCode.ACCELERATION_LIMIT,
                what=self.joint_names[joint],
                value=_rate(request[joint] - last_dq[joint], self.cycle_s**2),
                bound=float(self.max_dv[joint] / self.cycle_s**2),
            )
        return max(0.0, scale), [reason]

    def slow_scale(self, brake: Array, request: Array, share: float) -> float:
        """Largest s that leaves every joint within a fraction of its velocity limit; 0 while the brake is faster."""
        allowed = share * self.max_dq
        if (np.abs(brake) > allowed).any():
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
        ends, beyond = self._brake_ends(brake, request, q_cmd, np.array([at_most]))
        if (beyond <= _ROUNDING).all():
            return at_most, []
        joint = int(beyond[0].argmax())
        up = ends[0, joint] > q_cmd[joint]
        reason = Reason(
            code=ReasonCode.POSITION_LIMIT,
            what=self.joint_names[joint],
            value=float(ends[0, joint]),
            bound=float(self.upper[joint] if up else self.lower[joint]),
        )
        scales = _SCALES[at_most > _SCALES][::-1]
        _, beyond = self._brake_ends(brake, request, q_cmd, scales)
        inside = (beyond <= _ROUNDING).all(axis=1)
        return (float(scales[int(inside.argmax())]) if inside.any() else 0.0), [reason]

    def _brake_ends(self, brake: Array, request: Array, q_cmd: Array, scales: Array) -> tuple[Array, Array]:
        """Ends of the brakes after increments of some scales, and how far each joint is beyond its limits there.

        Args:
            brake: (n,) next increment of the brake.
            request: (n,) increment asked for.
            q_cmd: (n,) setpoint; a joint that stands outside its limits may come to rest there.
            scales: (k,) to be tried.

        Returns:
            Both (k, n) [rad or m]; a joint inside its limits is beyond them by less than zero.
        """
        dq = brake + scales[:, None] * (request - brake)
        cycles = np.ceil((np.abs(dq) / self.max_dv).max(axis=1) * (1 - _SLACK)).clip(min=1)
        ends: Array = q_cmd + dq * ((cycles + 1) / 2)[:, None]
        beyond: Array = np.maximum(ends - np.maximum(self.upper, q_cmd), np.minimum(self.lower, q_cmd) - ends)
        return ends, beyond

    def brake_cycles(self, dq: Array) -> int:
        """Length of the brake that follows `dq`."""
        return brake_cycles(dq, self.max_dv)
