"""Where the hands are to be: the line that an operator has them follow, and the way back to it."""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.modes.hand_kinematics import displacement, turned
from deltaq_controllers.modes.hands import Hands
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
        most_m, most_rad = time_s * TAKEN_BACK_M_S, time_s * TAKEN_BACK_RAD_S
        return _back(hands.rotations, hands.positions, self._rotations, self._positions, most_m, most_rad)

    def go(self, way: Array, held: HeldObject | None = None) -> None:
        """The hands are to go on by displacements (h, 6) [m, rad], and to keep the object that they hold."""
        assert self._rotations is not None  # begun
        self._rotations, self._positions = _gone(self._rotations, self._positions, way)
        self._keep(held)


@compiled
def _back(
    rotations: Array,
    positions: Array,
    to_rotations: Array,
    to_positions: Array,
    most_m: float,
    most_rad: float,
) -> Array:
    """`Line.back`."""
    error = displacement(rotations, positions, to_rotations, to_positions)
    for hand in range(len(error)):
        for first, most in ((0, most_m), (3, most_rad)):
            x, y, z = error[hand, first], error[hand, first + 1], error[hand, first + 2]
            share = min(1.0, most / max(math.sqrt(x * x + y * y + z * z), 1e-15))
            for axis in range(first, first + 3):
                error[hand, axis] *= share
    return error


@compiled
def _gone(rotations: Array, positions: Array, way: Array) -> tuple[Array, Array]:
    """Poses after a way (h, 6)."""
    return turned(rotations, way[:, 3:]), positions + way[:, :3]
