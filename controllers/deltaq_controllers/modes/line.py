"""Where the hands are to be: the line that an operator has them follow, and the way back to it."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.modes.hands import Hands, turned
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_protocol.arrays import Array

TAKEN_BACK_M_S, TAKEN_BACK_RAD_S = 2e-3, 2e-3
"""Greatest rate at which a hand comes back to its line [m/s, rad/s]."""


class Line:
    """The poses that the hands are to have, cycle after cycle.

    Attributes:
        is_set: whether there is one.
    """

    def __init__(self) -> None:
        self._rotations: Array | None = None
        self._positions: Array = np.zeros((0, 3))

    @property
    def is_set(self) -> bool:
        """Whether there is a line."""
        return self._rotations is not None

    def begin(self, hands: Hands, held: HeldObject | None = None) -> None:
        """The line begins where the hands are, or where they keep the object that they hold."""
        self._rotations, self._positions = hands.rotations.copy(), hands.positions.copy()
        self._keep(held)

    def _keep(self, held: HeldObject | None) -> None:
        if held is not None and self._rotations is not None:
            self._rotations, self._positions = held.placed(self._rotations, self._positions)

    def forget(self) -> None:
        """There is no line any more."""
        self._rotations = None

    def back(self, hands: Hands, time_s: float) -> Array:
        """(h, 6) displacement that takes the hands back to it, clipped to what is corrected within a time [m, rad]."""
        assert self._rotations is not None  # begun
        error = hands.error(self._rotations, self._positions).reshape(-1, 6)
        for part, rate in ((slice(0, 3), TAKEN_BACK_M_S), (slice(3, 6), TAKEN_BACK_RAD_S)):
            sizes = np.linalg.norm(error[:, part], axis=1)
            error[:, part] *= np.minimum(1.0, time_s * rate / np.maximum(sizes, 1e-15))[:, None]
        return error

    def go(self, displacement: Array, held: HeldObject | None = None) -> None:
        """The hands are to go on by displacements (h, 6) [m, rad], and to keep the object that they hold."""
        assert self._rotations is not None  # begun
        self._rotations = turned(self._rotations, displacement[:, 3:])
        self._positions = self._positions + displacement[:, :3]
        self._keep(held)
