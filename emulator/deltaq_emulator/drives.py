"""The drives of the robot: their setpoint, the robot's position, and how they come to rest by themselves."""

from __future__ import annotations

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_emulator.servo import Servo
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
        """The setpoint stands still, and the robot has reached it."""
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
        """Keep the setpoint, whatever it did before."""
        self._step = np.zeros_like(self._step)

    def brake(self) -> None:
        """One cycle of the drives' own ramp: each axis at its own deceleration limit."""
        if not self._step.any():
            return
        speed = np.maximum(np.abs(self._step) - self._brake, 0.0)
        self.send_to(np.clip(self.setpoint + np.sign(self._step) * speed, self._lower, self._upper))
