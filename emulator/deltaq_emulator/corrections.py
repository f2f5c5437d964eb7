"""The total correction: absolute or relative, with HOLDON for late telegrams, within limits.

| | HOLDON 1 | HOLDON 0 |
| --- | --- | --- |
| absolute | a lost telegram is bridged: the offset stays | jumps back to where RSI started |
| relative | repeats the last increment, cycle after cycle | the increment is lost |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from deltaq_emulator.settings import CorrectionMode, KrcSettings
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
