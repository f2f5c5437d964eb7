"""The total correction: absolute or relative, with HOLDON for late telegrams, within limits.

| | HOLDON 1 | HOLDON 0 |
| --- | --- | --- |
| absolute | a lost telegram is bridged: the offset stays | jumps back to where RSI started |
| relative | repeats the last increment, cycle after cycle | the increment is lost |
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_emulator.catalogue import Code, KrcMessage
from deltaq_emulator.settings import CorrectionMode, KrcSettings, OperatingMode
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import AxisMap, KrcCodec, SensorTelegram


class Corrections:
    """The correction object of the controller (AXISCORR and AXISCORREXT), and the signals that come with it.

    Args:
        codec: gives HOLDON of every element.
        limits: bounds at which the total correction is clipped.
    """

    def __init__(self, codec: KrcCodec, limits: CorrectionLimits) -> None:
        self._hold_on = codec.hold_on
        self._output_hold_on = codec.output_hold_on
        self._stop_hold_on = codec.stop_hold_on
        self._limits = limits
        self.outputs: dict[str, bool] = dict.fromkeys(codec.output_hold_on, False)
        """Digital outputs as they are."""
        self.clamped = 0
        """Cycles in which a correction was clipped at its limit."""
        self.begin_session("absolute")

    def begin_session(self, mode: CorrectionMode) -> None:
        """Start from no correction."""
        self.turn(mode)
        self._value = np.zeros(len(self._hold_on))
        self.total = np.zeros(len(self._hold_on))
        """(n,) sum of all corrections of this session [rad or m]."""
        self._stop = False
        self.stop_rose = False
        """The signal that ends the motion rose in the last cycle."""

    def turn(self, mode: CorrectionMode) -> None:
        """Take corrections as offsets or add them up, from now on."""
        self._relative = mode == "relative"

    def take(self, reply: SensorTelegram | None) -> None:
        """Take the reply of a cycle, or None if there was none."""
        held = np.where(self._hold_on, self._value, 0.0)
        self._value = held if reply is None else np.where(reply.present, reply.correction, held)
        received = {} if reply is None else reply.outputs
        for name, hold_on in self._output_hold_on.items():
            self.outputs[name] = received.get(name, self.outputs[name] if hold_on else False)
        before = self._stop
        told = None if reply is None else reply.stop
        self._stop = (before and self._stop_hold_on) if told is None else told
        self.stop_rose = self._stop and not before

    def move(self) -> Array:
        """One cycle of RSI_MOVECORR: returns the (n,) total correction [rad or m]."""
        asked = self.total + self._value if self._relative else self._value
        self.total = np.clip(asked, self._limits.lower, self._limits.upper)
        self.clamped += bool((self.total != asked).any())
        return self.total


def in_units(axes: AxisMap, degrees: float, millimetres: float) -> Array:
    """(n,) bounds [rad or m] that are given for rotating axes in degrees and for linear ones in mm."""
    return np.array([degrees if unit == "rad" else millimetres for unit in axes.units]) / axes.commanded


@dataclass(frozen=True)
class CorrectionLimits:
    """Limits of the total correction of each axis, from where RSI started [rad or m].

    Attributes:
        lower: (n,) AXISCORR and AXISCORREXT clip a correction here; upper: and here.
        monitor: (n,) AXISCORRMON stops RSI beyond this, in either direction.
    """

    lower: Array
    upper: Array
    monitor: Array

    @classmethod
    def of(cls, axes: AxisMap, settings: KrcSettings) -> Self:
        """The same for all rotating and for all linear axes, as the settings say."""
        limit = in_units(axes, settings.correction_limit_deg, settings.correction_limit_mm)
        return cls(-limit, limit, in_units(axes, settings.monitor_limit_deg, settings.monitor_limit_mm))


# Monitors by which the controller stops the robot: limits, and the message that names the axis and the excess.


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
