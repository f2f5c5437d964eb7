"""Rounding of relative corrections that never accumulates."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.rsi.axes import Array, AxisMap

DECIMALS = 6
"""Decimals of a correction on the wire."""


class RelativeRounder:
    """Rounds increments to what the wire can carry and adds what was cut off to the next one.

    The sum of everything sent is then never further from the sum of everything asked for than half of
    the last decimal. Absolute corrections need no such thing: each is rounded by itself.
    """

    def __init__(self, axes: AxisMap, decimals: int = DECIMALS) -> None:
        self._commanded = axes.commanded
        self._decimals = decimals
        self._remainder = np.zeros(len(axes.axes))

    @property
    def remainder(self) -> Array:
        """(n,) what has been asked for and not been sent yet [rad or m]."""
        return self._remainder / self._commanded

    def round(self, dq: Array) -> Array:
        """The (n,) increment to send instead of `dq` [rad or m]."""
        asked = dq * self._commanded + self._remainder
        sent = np.round(asked, self._decimals)
        self._remainder = asked - sent
        return np.asarray(sent / self._commanded, dtype=np.float64)

    def reset(self) -> None:
        """Forget the remainder, as a new RSI session demands."""
        self._remainder = np.zeros_like(self._remainder)
