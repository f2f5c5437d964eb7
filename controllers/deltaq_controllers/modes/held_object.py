"""An object that all hands of a robot hold, and move as one: their poses to one another are kept."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from deltaq_controllers.modes.conditioning import LENGTH_M
from deltaq_protocol.arrays import Array


class HeldObject:
    """Where the hands hold an object. Its origin is midway between them, its axes were the world's when it was taken.

    Args:
        rotations: (h, 3, 3) axes of the hands in the world as they take it.
        positions: (h, 3) origins of the hands in the world [m].
    """

    def __init__(self, rotations: Array, positions: Array) -> None:
        self._rotations = rotations.copy()
        self._offsets: Array = positions - positions.mean(axis=0)

    def axes(self, rotations: Array) -> Array:
        """(3, 3) axes of the object in the world: the mean turn of the hands (h, 3, 3) since they took it."""
        turns = rotations @ self._rotations.transpose(0, 2, 1)
        mean = np.mean([pin.log3(turns[0].T @ turn) for turn in turns], axis=0)
        axes: Array = turns[0] @ pin.exp3(mean)
        return axes

    def placed(self, rotations: Array, positions: Array) -> tuple[Array, Array]:
        """Poses of the hands as they took the object, with the object where hands at these poses have it.

        Args:
            rotations: (h, 3, 3) axes of the hands in the world.
            positions: (h, 3) origins of the hands in the world [m].

        Returns:
            Axes and origins of the hands, kept together.
        """
        axes = self.axes(rotations)
        return axes @ self._rotations, positions.mean(axis=0) + self._offsets @ axes.T

    def parted(self, rotations: Array, positions: Array) -> tuple[float, float]:
        """By how much hands at these poses are off from how they took it, to one another [m, rad]."""
        back, turn = rotations[0] @ self._rotations[0].T, 0.0
        arms = (positions - positions[0]) - (self._offsets - self._offsets[0]) @ back.T
        for now, taken in zip(rotations, self._rotations, strict=True):
            turn = max(turn, float(np.linalg.norm(pin.log3((back @ taken).T @ now))))
        return float(np.linalg.norm(arms, axis=1).max()), turn

    def hands_twists(self, positions: Array, twist: Array) -> Array:
        """(h, 6) velocities of hands at (h, 3) for a twist (6,) of the object at its origin, world axes."""
        arms = positions - positions.mean(axis=0)
        velocities = twist[:3] + np.cross(twist[3:], arms)
        return np.hstack([velocities, np.tile(twist[3:], (len(arms), 1))])

    def together(self, positions: Array, rates: Array) -> Array:
        """(6 h,) rates of hands at (h, 3), turns as travel, without what would part them: a least square [m/s]."""
        columns = [self.hands_twists(positions, unit) for unit in np.eye(6)]
        for column in columns:
            column[:, 3:] *= LENGTH_M
        basis = np.array([column.ravel() for column in columns]).T
        twist = np.linalg.solve(basis.T @ basis, basis.T @ rates)
        kept: Array = basis @ twist
        return kept
