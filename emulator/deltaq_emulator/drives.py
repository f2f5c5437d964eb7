"""The drives of the robot: their setpoint, the robot's position, and how they come to rest by themselves."""

import math
from collections import deque

import numpy as np

from deltaq_cell.description import RobotDescription, ServoLag
from deltaq_cell.drive_lag import transition
from deltaq_protocol.arrays import Array

REST_TOLERANCE = 1e-5
"""A robot nearer to its setpoint than this has come to rest [rad or m]."""


class Drives:
    """Setpoint and motion of one robot.

    Args:
        robot: deceleration limits, lag of the drives.
        cycle_s: duration of a cycle [s].
        q: (n,) where the robot stands [rad or m].
        lower: (n,) software limit switches, which the drives do not pass; upper: likewise [rad or m].
    """

    def __init__(self, robot: RobotDescription, cycle_s: float, q: Array, lower: Array, upper: Array) -> None:
        self._servo = Servo(q, robot.servo_lag, cycle_s)
        self._brake = robot.max_acceleration * cycle_s**2
        self._lower, self._upper = lower, upper
        self.setpoint = q.copy()
        """(n,) setpoint of the drives [rad or m]."""
        self._step = np.zeros_like(q)

    @property
    def q(self) -> Array:
        """(n,) position of the robot [rad or m]."""
        return self._servo.q

    @property
    def at_rest(self) -> bool:
        """Whether the setpoint is constant and the robot has reached it."""
        return not self._step.any() and bool((np.abs(self.q - self.setpoint) < REST_TOLERANCE).all())

    def advance(self) -> Array:
        """Move for one cycle; returns the (n,) motion [rad or m]."""
        before = self._servo.q
        self._servo.advance(self.setpoint)
        return self._servo.q - before

    def send_to(self, setpoint: Array) -> None:
        """Take the (n,) setpoint of the next cycle [rad or m]."""
        self._step = setpoint - self.setpoint
        self.setpoint = setpoint

    def stand(self) -> None:
        """Repeat the present setpoint."""
        self._step = np.zeros_like(self._step)

    def brake(self) -> None:
        """One cycle of the drives' own ramp: each axis at its own deceleration limit."""
        if not self._step.any():
            return
        speed = np.maximum(np.abs(self._step) - self._brake, 0.0)
        self.send_to(np.clip(self.setpoint + np.sign(self._step) * speed, self._lower, self._upper))


# The drives' lag from setpoint to motion: dead time, then a second-order lag for each joint.
#
#     q'' = w^2 (u - q) - 2 z w q'
#
# where u is the setpoint, interpolated linearly over each cycle as the drives' fine interpolation does, and delayed by
# the dead time. The update is exact, not a numerical integration: the solution for a linear input is a ramp plus a
# decaying part whose transition matrix has a closed form. With damping z >= 1 nothing overshoots.

_SAME = 1e-9


class Servo:
    """The drives of one robot.

    Args:
        q: (n,) where the robot stands [rad or m].
        lag: dead time and second-order lag, the same for every joint.
        cycle_s: duration of `advance`.
    """

    def __init__(self, q: Array, lag: ServoLag, cycle_s: float) -> None:
        self.q = q.copy()
        """(n,) actual position [rad or m]."""
        self.dq_dt = np.zeros_like(q)
        """(n,) actual velocity [rad/s or m/s]."""
        cycles = lag.dead_time_s / cycle_s
        whole = math.floor(cycles + _SAME)
        share = max(cycles - whole, 0.0)
        self._share = share if share > _SAME else 0.0
        # the newest setpoint last; how many cycles of the past the delayed input reaches back
        self._setpoints = deque([q.copy() for _ in range(whole + 3)], maxlen=whole + 3)
        self._ramp_lag_s = 2.0 * lag.damping / lag.natural_frequency_rad_s
        self._cycle_s = cycle_s
        self._steps = [
            (duration, transition(duration, lag.natural_frequency_rad_s, lag.damping))
            for duration in (self._share * cycle_s, (1.0 - self._share) * cycle_s)
        ]

    def advance(self, setpoint: Array) -> None:
        """Move for one cycle, during which the setpoint goes linearly from the last one to `setpoint`."""
        self._setpoints.append(setpoint.copy())
        before, start, end = self._setpoints[0], self._setpoints[1], self._setpoints[2]
        if self._share:
            slope = (start - before) / self._cycle_s
            self._follow(start - slope * self._steps[0][0], slope, *self._steps[0])
        self._follow(start, (end - start) / self._cycle_s, *self._steps[1])

    def _follow(self, u: Array, slope: Array, duration_s: float, phi: Array) -> None:
        # the ramp that the robot would follow for ever lags behind the input
        ramp = u - slope * self._ramp_lag_s
        e, de = self.q - ramp, self.dq_dt - slope
        self.q = ramp + slope * duration_s + phi[0, 0] * e + phi[0, 1] * de
        self.dq_dt = slope + phi[1, 0] * e + phi[1, 1] * de
