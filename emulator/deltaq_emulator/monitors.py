"""Monitors by which the controller stops the robot: limits, and the message that names the axis and the excess."""

from collections import deque

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_emulator.catalogue import Code, KrcMessage
from deltaq_emulator.corrections import in_units
from deltaq_emulator.settings import KrcSettings, OperatingMode
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import AxisMap

ACCELERATION_CYCLES = 10
"""Cycles over which the acceleration is averaged, so that a lost telegram does not count as one."""
LIMIT_TOLERANCE = 1e-5
"""How far beyond a software limit switch a setpoint may be [rad or m]: the rounding of telegrams."""


class Monitors:
    """The controller's own limits of one robot.

    Args:
        robot: software limit switches, speeds and accelerations.
        axes: its axes, for messages.
        settings: tolerances of the limits.
        cycle_s: duration of a cycle [s].
        correction: (n,) total correction at which RSI is stopped [rad or m].
    """

    def __init__(
        self, robot: RobotDescription, axes: AxisMap, settings: KrcSettings, cycle_s: float, correction: Array
    ) -> None:
        self._axes = axes
        self._cycle_s = cycle_s
        self._correction = correction
        self.lower = robot.lower - LIMIT_TOLERANCE
        """(n,) software limit switches [rad or m]."""
        self.upper = robot.upper + LIMIT_TOLERANCE
        """(n,) software limit switches [rad or m]."""
        self._speed = settings.velocity_stop_factor * robot.max_velocity
        jump = in_units(axes, settings.jump_stop_deg, settings.jump_stop_mm)
        self._jump_acceleration = jump / cycle_s**2
        self._acceleration = settings.acceleration_stop_factor * robot.max_acceleration
        self._steps: deque[Array] = deque(maxlen=ACCELERATION_CYCLES)
        self.begin_session(np.zeros(len(axes)))
        self._t1_speed_m_s = settings.t1_speed_m_s

    def begin_session(self, setpoint: Array) -> None:
        """Start from rest at `setpoint` (n,) [rad or m]."""
        self._setpoint = setpoint
        self._steps.extend([np.zeros_like(setpoint)] * ACCELERATION_CYCLES)

    def of_setpoint(self, setpoint: Array, total: Array) -> KrcMessage | None:
        """Why the drives cannot be sent to `setpoint`, if they cannot; called once a cycle.

        Args:
            setpoint: (n,) [rad or m].
            total: (n,) sum of all corrections.
        """
        step, self._setpoint = setpoint - self._setpoint, setpoint
        first, last = self._steps[0], self._steps[-1]
        self._steps.append(step)
        if (np.abs(total) > self._correction).any():
            return self._worst(Code.CORRECTION_MONITOR, np.abs(total), self._correction)
        if (setpoint > self.upper).any():
            return self._worst(Code.SOFTWARE_LIMIT, setpoint, self.upper)
        if (setpoint < self.lower).any():
            return self._worst(Code.SOFTWARE_LIMIT, -setpoint, -self.lower, sign=-1.0)
        acceleration = np.abs(step - last) / self._cycle_s**2
        if (acceleration > self._jump_acceleration).any():
            return self._worst(Code.GEAR_TORQUE, acceleration, self._jump_acceleration)
        acceleration = np.abs(step - first) / (ACCELERATION_CYCLES * self._cycle_s**2)
        if (acceleration > self._acceleration).any():
            return self._worst(Code.GEAR_TORQUE, acceleration, self._acceleration)
        return None

    def of_motion(self, dq: Array, tool_m: float, mode: OperatingMode) -> KrcMessage | None:
        """The message that stops the robot because of its motion in the last cycle; None if the motion is permitted.

        Args:
            dq: (n,) motion of the joints [rad or m].
            tool_m: motion of the tool [m].
            mode: T1 bounds the tool's speed.
        """
        speed = np.abs(dq) / self._cycle_s
        if (speed > self._speed).any():
            return self._worst(Code.KINETIC_ENERGY, speed, self._speed)
        if mode is OperatingMode.T1 and tool_m / self._cycle_s > self._t1_speed_m_s:
            return KrcMessage(Code.T1_SPEED, "", tool_m / self._cycle_s, self._t1_speed_m_s, "m")
        return None

    def _worst(self, code: Code, value: Array, bound: Array, sign: float = 1.0) -> KrcMessage:
        """The message for the axis that exceeds its bound most, in deg or mm."""
        worst = int(np.argmax((value - bound) * self._axes.commanded))
        scale = sign * float(self._axes.commanded[worst])
        unit = "deg" if self._axes.units[worst] == "rad" else "mm"
        return KrcMessage(
            code, self._axes.axes[worst], float(value[worst]) * scale, float(bound[worst]) * scale, unit
        )
