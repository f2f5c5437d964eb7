"""Clip an increment so that the gate admits it unchanged: speed, acceleration, and room to brake.

The gate follows an admitted increment by a brake along a straight line in joint space
(`deltaq_protocol.brake`), so the room to a position limit that an increment needs depends on all joints.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.messages import RobotSummary

_SHY = 1.0 - 1e-6
"""Fraction of each limit that is used, so that rounding never counts as a violation."""

_ROUNDING = 1e-12
"""An end of a brake that is outside by no more than this lies on the limit [rad or m]."""

_BISECTIONS = 10
"""A thousandth of the blend from the brake to the wanted increment is accurate enough."""


class IncrementLimits(NamedTuple):
    """Limits of one robot's increments.

    Attributes:
        lower: (n,) lower limits [rad or m].
        upper: (n,) upper limits [rad or m].
        max_dq: (n,) largest increment [rad or m].
        max_ddq: (n,) largest change of the increment between two cycles [rad or m].
    """

    lower: Array
    upper: Array
    max_dq: Array
    max_ddq: Array

    @classmethod
    def of(cls, robot: RobotModel, cycle_s: float) -> Self:
        """Limits of a robot with sampling time `cycle_s` [s]."""
        return cls._of(robot.lower, robot.upper, robot.max_velocity, robot.max_acceleration, cycle_s)

    @classmethod
    def told(cls, summary: RobotSummary, cycle_s: float) -> Self:
        """Limits of a robot from the summary that its HLI gives."""
        lower, upper = np.array(summary.lower), np.array(summary.upper)
        return cls._of(
            lower, upper, np.array(summary.max_velocity), np.array(summary.max_acceleration), cycle_s
        )

    @classmethod
    def _of(
        cls, lower: Array, upper: Array, max_velocity: Array, max_acceleration: Array, cycle_s: float
    ) -> Self:
        slack = (1.0 - _SHY) * (upper - lower)
        max_dq, max_ddq = _SHY * cycle_s * max_velocity, _SHY * cycle_s**2 * max_acceleration
        return cls(lower + slack, upper - slack, max_dq, max_ddq)

    def _excess(self, q_cmd: Array, dq: Array) -> Array:
        """(n,) how far the end of the brake after `dq` lies outside; zero or less: inside."""
        end = q_cmd + dq * (0.5 * (brake_cycles(dq, self.max_ddq) + 1))
        excess: Array = np.maximum(end - self.upper, self.lower - end)
        return excess

    def reach(self, dq_last: Array) -> tuple[Array, Array]:
        """Least and greatest increment (n,) that speed and acceleration allow after `dq_last` (n,)."""
        slowest = np.maximum(dq_last - self.max_ddq, -self.max_dq)
        fastest = np.minimum(dq_last + self.max_ddq, self.max_dq)
        return np.minimum(slowest, fastest), np.maximum(slowest, fastest)

    def admissible(self, dq: Array, q_cmd: Array, dq_last: Array) -> Array:
        """The increment nearest to `dq` that the gate admits unchanged.

        Joints are clipped one by one. Where that leaves no room to brake, the wanted increment is blended with the
        brake of the last one, as the gate would do; the brake itself always has room.

        Args:
            dq: (n,) wanted increment [rad or m].
            q_cmd: (n,) setpoint that it is added to [rad or m].
            dq_last: (n,) increment that led to the setpoint [rad or m].

        Returns:
            (n,) increment [rad or m].
        """
        slowest, fastest = self.reach(dq_last)
        wanted = np.minimum(np.maximum(dq, slowest), fastest)
        excess = self._excess(q_cmd, wanted)
        if excess.max() <= 0.0:
            return wanted
        cycles = brake_cycles(dq_last, self.max_ddq)
        brake = dq_last * ((cycles - 1) / cycles)
        # a robot that stands outside may stay there, but go no farther
        room = np.maximum(self._excess(q_cmd, brake), 0.0) + _ROUNDING
        if (excess <= room).all():
            return wanted
        reach = 2.0 / (brake_cycles(wanted, self.max_ddq) + 1)
        wanted = np.minimum(np.maximum(wanted, reach * (self.lower - q_cmd)), reach * (self.upper - q_cmd))
        wanted = np.minimum(np.maximum(wanted, slowest), fastest)
        if (self._excess(q_cmd, wanted) <= room).all():
            return wanted
        good, bad = 0.0, 1.0
        for _ in range(_BISECTIONS):
            share = 0.5 * (good + bad)
            if (self._excess(q_cmd, brake + share * (wanted - brake)) <= room).all():
                good = share
            else:
                bad = share
        return brake + good * (wanted - brake)
