"""Measures the lag of each axis while it moves.

A model of the drives, a dead time and a second order, follows the setpoints that were sent. Without its dead time it
is at `p(t)`. Drives of the dead time `m` are then near `p(t - m)`. With a guess `g` of it the rest is

    p(t - g) - q(t) = (m - g) p'(t - g)

so that `m` is a quotient of two sums over the newest cycles, each weighted with the square of its speed: fast motion
has more weight than slow motion, and noise that is independent of the motion averages out. The result is the next
guess.

The session's probe gave the response and the damping of the model, and the difference of settling time and mean
delay (`deltaq_cell.drive_lag`). The result is the dead time of the moving axis plus that lag. Without
the second order, acceleration would pass for lag: drives that swing would seem to lag up to 30 ms more than they do.
"""

import math

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_cell.drive_lag import LONGEST_S, AxisLag, lag_fault, transition
from deltaq_protocol.arrays import Array, Flags
from deltaq_services.containment import Part

_MEMORY_S = 0.4
"""Time constant with which motion is forgotten."""

_TOLD_S = 0.4
"""A lag counts that was too long for so long, in motion and without a break: one sum may be wrong while a joint comes
to rest, since its response is then older than its mean delay."""

_LEAST_OVERSHOOT = 0.01
"""A probe cannot tell less from none."""

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
        models = [_second_order(lag, cycle_s, presumed_s) for lag in lags]
        self._steps = np.array([transition(cycle_s, frequency, damping) for frequency, damping in models])
        self._response_s = np.array([2.0 * damping / frequency for frequency, damping in models])
        self._places = np.tile(setpoint, (self._longest + 2, 1))  # of the model, newest first
        self._speed = np.zeros_like(setpoint)
        self._setpoints = np.array([setpoint, setpoint])  # sent last, and the one that the KRC had then
        self._columns = np.arange(len(setpoint))
        self._least = np.array([_LEAST_RAD if unit == "rad" else _LEAST_M for unit in robot.units]) ** 2
        self._keep = math.exp(-cycle_s / _MEMORY_S)
        self._told_cycles = math.ceil(_TOLD_S / cycle_s)
        settles = [lag is not None and math.isfinite(lag.settled_s) for lag in lags]
        self._probed = np.array(settles)
        mean_s = np.array([presumed_s / 2 if lag is None else lag.mean_s for lag in lags])
        self._dead_s = np.maximum(mean_s - self._response_s - cycle_s, 0.0)
        self._settling_s = np.array(
            [
                lag.settled_s - lag.mean_s if lag and known else 0.0
                for lag, known in zip(lags, settles, strict=True)
            ]
        )
        self._sums = np.zeros(
            (2, len(setpoint))
        )  # of squared increments times dead time, and of squared increments
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
        sent, had = self._setpoints
        has = had if missed_last else sent
        for before in (had, *[has] * min(round(passed / self._ipoc_step) - 1, self._longest)):
            self._follow(before, has)
        self._setpoints = np.array([setpoint, has])
        if self._rested < self._longest:
            self._measure(q)

    def lag_s(self) -> tuple[float | None, ...]:
        """(n,) lag of each axis until a step has settled, to the millisecond; None where it is not known.

        Where the probe did not tell how a step settles, it is the mean delay of the moving axis.
        """
        settled_s, known = self._delay_s + self._settling_s, self._moves | self._probed
        told = zip(settled_s.tolist(), known.tolist(), strict=True)
        return tuple(round(lag_s, 3) if is_known else None for lag_s, is_known in told)

    def _follow(self, start: Array, end: Array) -> None:
        """The model's motion in a cycle in which the setpoint goes evenly from one (n,) to another."""
        self._rested = self._rested + 1 if np.array_equal(start, end) else 0
        if self._rested > 2 * self._longest:
            return
        slope = (end - start) / self._cycle_s
        # the ramp that it would follow for ever is behind the setpoint by the response
        ramp = start - slope * self._response_s
        error = np.array([self._places[0] - ramp, self._speed - slope])
        place, speed = np.einsum("jik,kj->ij", self._steps, error)
        self._speed = slope + speed
        self._places = np.vstack([ramp + slope * self._cycle_s + place, self._places[:-1]])

    def _measure(self, q: Array) -> None:
        guess = np.clip((self._delay_s - self._response_s) / self._cycle_s - 1.0, 0.0, self._longest - 1.0)
        rows = guess.astype(np.intp)
        later, earlier = self._places[rows, self._columns], self._places[rows + 1, self._columns]
        speed = later - earlier
        rest = later - (guess - rows) * speed - q
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
        dead_s = self._dead_s.copy()
        np.divide(self._sums[0], self._sums[1] / self._cycle_s, out=dead_s, where=moves)
        return moves, self._cycle_s + dead_s + self._response_s


def _second_order(lag: AxisLag | None, cycle_s: float, presumed_s: float) -> tuple[float, float]:
    """Natural frequency [rad/s] and damping of drives, without their dead time.

    The overshoot tells the damping. From 5 to 50 % of a step a second order takes about (0.685 + 0.66 z) / w.
    """
    if lag is None:
        return 4.0 / presumed_s, 1.0
    damping = 1.0
    if lag.overshoot > _LEAST_OVERSHOOT:
        decrement = math.log(lag.overshoot)
        damping = -decrement / math.hypot(math.pi, decrement)
    rise_s, mean_s = max(lag.half_s - lag.dead_s, 1e-3), max(lag.mean_s - cycle_s, 1e-3)
    return max((0.685 + 0.66 * damping) / rise_s, 2.0 * damping / mean_s), damping
