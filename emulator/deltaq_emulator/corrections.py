"""What corrections come to: absolute or relative, with HOLDON for late telegrams, within limits.

| | HOLDON 1 | HOLDON 0 |
| --- | --- | --- |
| absolute | a lost telegram is bridged: the offset stays | jumps back to where RSI started |
| relative | repeats the last increment, cycle after cycle | the increment is lost |
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_cell.description import Array
from deltaq_emulator.settings import KrcSettings
from deltaq_protocol.rsi import AxisMap, KrcCodec, SensorTelegram


def in_units(axes: AxisMap, degrees: float, millimetres: float) -> Array:
    """(n,) bounds [rad or m] that are given for rotating axes in degrees and for linear ones in mm."""
    return np.array([degrees if unit == "rad" else millimetres for unit in axes.units]) / axes.commanded


class Corrections:
    """The correction object of the controller (AXISCORR and AXISCORREXT)."""

    def __init__(self, codec: KrcCodec, axes: AxisMap, settings: KrcSettings) -> None:
        self._hold_on = codec.hold_on
        self._output_hold_on = codec.output_hold_on
        self._relative = settings.correction == "relative"
        self._limit = in_units(axes, settings.correction_limit_deg, settings.correction_limit_mm)
        self.outputs: dict[str, bool] = dict.fromkeys(codec.output_hold_on, False)
        """Digital outputs as they are."""
        self.clamped = 0
        """Cycles in which a correction was cut off at its limit."""
        self.reset()

    def reset(self) -> None:
        """Begin a session: no correction."""
        self._value = np.zeros(len(self._hold_on))
        self.total = np.zeros(len(self._hold_on))
        """(n,) sum of all corrections of this session [rad or m]."""

    def apply(self, reply: SensorTelegram | None) -> Array:
        """Take the reply of a cycle, or that there was none; returns the total correction."""
        held = np.where(self._hold_on, self._value, 0.0)
        self._value = held if reply is None else np.where(reply.present, reply.correction, held)
        asked = self.total + self._value if self._relative else self._value
        self.total = np.clip(asked, -self._limit, self._limit)
        self.clamped += bool((self.total != asked).any())
        self._set_outputs({} if reply is None else reply.outputs)
        return self.total

    def _set_outputs(self, received: Mapping[str, bool]) -> None:
        for name, hold_on in self._output_hold_on.items():
            self.outputs[name] = received.get(name, self.outputs[name] if hold_on else False)
