"""A robot's hands: where they are, how they move with the joints, and which joints carry which."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.conditioning import LENGTH_M
from deltaq_controllers.modes.hand_kinematics import displacement, links_of, placed
from deltaq_protocol.arrays import Array

ARM_JOINTS = 6
"""Joints next to a hand that make up its arm."""


class Hands:
    """The hands of one robot.

    Args:
        robot: the robot.

    Attributes:
        names: of the hands; `tool` for the only one.
        moved_by: (h, n) whether joint j moves hand i.
        units: (6 h,) what a displacement of the hands counts as travel: 1, and `LENGTH_M` for turns [m/m, m/rad].
        arms: (h, n) whether joint j is one of the six next to hand i, and moves no other.
        rotations: (h, 3, 3) axes of each hand in the world, after `update`.
        positions: (h, 3) origin of each hand in the world [m].
        jacobian: (6 h, n) of the hands one under the other, linear over angular rows, world axes.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.names = robot.hands
        self.units = np.tile(np.repeat([1.0, LENGTH_M], 3), len(robot.hands))
        self._links = links_of(robot)
        self.moved_by = self._links.moved_by
        self.arms = np.zeros_like(self.moved_by)
        for arm, moves in zip(self.arms, self.moved_by, strict=True):
            own = np.flatnonzero(moves & (self.moved_by.sum(axis=0) == 1))
            arm[own[-ARM_JOINTS:]] = True
        self.update(robot.home)
        self.error(self.rotations, self.positions)  # so that no cycle waits for its machine code

    def update(self, q: Array) -> None:
        """Place the robot at `q` (n,)."""
        self.rotations: Array
        self.positions: Array
        self.jacobian: Array
        # a copy: for one of another kind, such as a read-only one, it would be compiled anew
        self.rotations, self.positions, self.jacobian = placed(self._links, np.array(q, dtype=np.float64))

    def place(self, q: Array) -> None:
        """Place the robot at `q` (n,) [rad or m] without updating `jacobian`."""
        self.rotations, self.positions, _ = placed(self._links, np.array(q, dtype=np.float64))

    def error(self, rotations: Array, positions: Array) -> Array:
        """(6 h,) displacement from the present poses to the given ones: offset [m] over rotation vector [rad]."""
        return displacement(self.rotations, self.positions, rotations, positions).ravel()
