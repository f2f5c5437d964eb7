"""How far a controller lets corrections go, axis by axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from deltaq_emulator.settings import KrcSettings
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import AxisMap


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
