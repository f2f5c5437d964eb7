"""The velocity of the focus, which the view has to compensate."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.arrays import Array


class FocusTracker:
    """An alpha-beta filter of a point.

    Args:
        alpha: fraction of the innovation that goes into the position.
        beta: fraction of the innovation that goes into the velocity.
        gap_s: after a longer silence than this the estimate restarts [s].

    Attributes:
        velocity: (3,) estimate [m/s].
    """

    def __init__(self, alpha: float = 0.7, beta: float = 0.4, gap_s: float = 0.5) -> None:
        self._alpha, self._beta, self._gap_s = alpha, beta, gap_s
        self._position: Array | None = None
        self._time_s = 0.0
        self.velocity: Array = np.zeros(3)

    def update(self, position: Array, time_s: float) -> None:
        """Add a measurement.

        Args:
            position: (3,) measured point [m].
            time_s: when it was measured, on any one clock; a stamp seen before changes nothing [s].
        """
        elapsed = time_s - self._time_s
        if self._position is None or elapsed < 0.0 or elapsed > self._gap_s:
            self._position, self.velocity = position.copy(), np.zeros_like(position)
        elif elapsed > 0.0:
            expected = self._position + elapsed * self.velocity
            innovation = position - expected
            self._position = expected + self._alpha * innovation
            self.velocity = self.velocity + (self._beta / elapsed) * innovation
        self._time_s = time_s
