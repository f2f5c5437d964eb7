"""Measures the lag of each axis while it moves.

A joint that was sent `c(t)` and lags by its mean delay `m` is near `c(t - m)`. With a guess `g` of it the rest is

    c(t - g) - q(t) = (m - g) c'(t - g)

so that `m` is a quotient of two sums over the newest cycles, each weighted with the square of its speed: fast motion
tells, rest does not, and noise that has nothing to do with the motion averages out. The next guess is the result.

The probe of the session told how much longer a step takes to settle than the mean delay (`deltaq_cell.drive_lag`). What
is told is the mean delay of the moving axis and that difference.
"""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_cell.drive_lag import LONGEST_S, AxisLag, lag_fault
from deltaq_protocol.arrays import Array, Flags
from deltaq_services.containment import Part

_MEMORY_S = 0.4
"""Time constant with which motion is forgotten."""

_TOLD_S = 0.4
"""A lag counts that was too long for so long, in motion and without a break: one sum may be wrong while a joint comes
to rest, since its response is then older than its mean delay."""

_LEAST_RAD, _LEAST_M = math.radians(0.25), 0.005
"""Root of the sum of squared increments from which on a joint tells: 5 deg/s do at 12 ms."""


class LagWatch(Part):
    """The lag of one robot's axes in one session.

    Args:
        robot: its joints.
        cycle_s: sample time.
        presumed_s: lag that the gate presumes.
        setpoint: (n,) that the KRC has [rad or m].
        lags: of each axis, by the session's probe.

    Attributes:
        fault: which axis lags more than the gate presumes, and the remedy; empty if none does.
    """

    def __init__(
        self,
        robot: RobotDescription,
        cycle_s: float,
        presumed_s: float,
        setpoint: Array,
        lags: tuple[AxisLag | None, ...],
    ) -> None:
        self.fault = ""
        self._axes, self._cycle_s, self._presumed_s = robot.joint_names, cycle_s, presumed_s
        self._longest = math.ceil(LONGEST_S / cycle_s) + 1
        self._setpoints = np.tile(setpoint, (self._longest + 1, 1))  # newest first
        self._columns = np.arange(len(setpoint))
        self._least = np.array([_LEAST_RAD if unit == "rad" else _LEAST_M for unit in robot.units]) ** 2
        self._keep = math.exp(-cycle_s / _MEMORY_S)
        self._told_cycles = math.ceil(_TOLD_S / cycle_s)
        settles = [lag is not None and math.isfinite(lag.settled_s) for lag in lags]
        self._probed = np.array(settles)
        self._mean_s = np.array([presumed_s / 2 if lag is None else lag.mean_s for lag in lags])
        self._settling_s = np.array(
            [
                lag.settled_s - lag.mean_s if lag and known else 0.0
                for lag, known in zip(lags, settles, strict=True)
            ]
        )
        self._sums = np.zeros(
            (2, len(setpoint))
        )  # of squared increments times delay, and of squared increments
        self._moves, self._delay_s = self._mean()
        self._rested = self._longest
        self._ipoc: int | None = None
        self._ipoc_step = 2**32
        self._too_long = 0

    def cycle(self, q: Array, ipoc: int, missed_last: bool, setpoint: Array) -> None:
        """One cycle of a session.

        Args:
            q: (n,) measured at its begin [rad or m].
            ipoc: the KRC's stamp. Where telegrams were lost, the KRC had the last setpoint meanwhile.
            missed_last: the last reply did not reach the KRC.
            setpoint: (n,) sent in reply [rad or m].
        """
        passed = 0 if self._ipoc is None else (ipoc - self._ipoc) % 2**32
        self._ipoc, self._ipoc_step = ipoc, min(self._ipoc_step, passed or 2**32)
        for _ in range(min(round(passed / self._ipoc_step) - 1, self._longest)):
            self._sent(self._setpoints[0])
        if missed_last:
            self._setpoints = np.vstack([self._setpoints[1], self._setpoints[1:]])
        if self._rested < self._longest:
            self._measure(q)
        self._sent(setpoint)

    def lag_s(self) -> tuple[float | None, ...]:
        """(n,) lag of each axis until a step has settled, to the millisecond; None where it is not known.

        Where the probe did not tell how a step settles, it is the mean delay of the moving axis.
        """
        settled_s, known = self._delay_s + self._settling_s, self._moves | self._probed
        told = zip(settled_s.tolist(), known.tolist(), strict=True)
        return tuple(round(lag_s, 3) if is_known else None for lag_s, is_known in told)

    def _sent(self, setpoint: Array) -> None:
        self._rested = self._rested + 1 if np.array_equal(setpoint, self._setpoints[0]) else 0
        if self._rested <= self._longest:
            self._setpoints = np.vstack([setpoint, self._setpoints[:-1]])

    def _measure(self, q: Array) -> None:
        guess = np.clip(np.rint(self._delay_s / self._cycle_s), 2, self._longest - 1).astype(np.intp)
        rows = guess - 1  # the newest setpoint was sent one cycle ago
        speed = (self._setpoints[rows - 1, self._columns] - self._setpoints[rows + 1, self._columns]) / 2
        rest = self._setpoints[rows, self._columns] - q
        self._sums = self._keep * self._sums + np.vstack([speed * (rest + guess * speed), speed * speed])
        self._moves, self._delay_s = self._mean()
        settled_s = self._delay_s + self._settling_s
        beyond = self._moves & (settled_s > self._presumed_s + self._cycle_s)
        self._too_long = self._too_long + 1 if beyond.any() else 0
        if self._too_long > self._told_cycles and not self.fault:
            beyond_s = np.where(beyond, settled_s, 0.0).tolist()
            self.fault = lag_fault(self._axes, beyond_s, self._presumed_s, self._cycle_s)

    def _mean(self) -> tuple[Flags, Array]:
        """(n,) whether each joint moved fast enough, and (n,) its mean delay [s]: of its motion, or of the probe."""
        moves = self._sums[1] > self._least
        mean_s = self._mean_s.copy()
        np.divide(self._sums[0], self._sums[1] / self._cycle_s, out=mean_s, where=moves)
        return moves, mean_s
