"""A robot's hands: where they are, how they move with the joints, and which joints carry which."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from deltaq_cell.robot import RobotModel
from deltaq_controllers.kinematics import joints_that_move
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
        arms: (h, n) whether joint j is one of the six next to hand i, and moves no other.
        rotations: (h, 3, 3) axes of each hand in the world, after `update`.
        positions: (h, 3) origin of each hand in the world [m].
        jacobian: (6 h, n) of the hands one under the other, linear over angular rows, world axes.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self.names = robot.hands
        self._frames = tuple(robot.frame_of(hand) for hand in robot.hands)
        carriers = np.array([robot.model.frames[frame].parentJoint for frame in self._frames])
        self.moved_by = joints_that_move(robot, carriers)
        self.arms = np.zeros_like(self.moved_by)
        for arm, moves in zip(self.arms, self.moved_by, strict=True):
            own = np.flatnonzero(moves & (self.moved_by.sum(axis=0) == 1))
            arm[own[-ARM_JOINTS:]] = True
        self.update(robot.home)

    def update(self, q: Array) -> None:
        """Place the robot at `q` (n,)."""
        columns = pin.computeJointJacobians(self._model, self._data, q)
        poses = [pin.updateFramePlacement(self._model, self._data, frame) for frame in self._frames]
        self.rotations: Array = np.array([pose.rotation for pose in poses])
        self.positions: Array = np.array([pose.translation for pose in poses])
        jacobian = np.tile(columns, (len(poses), 1))
        for hand, (x, y, z) in enumerate(self.positions.tolist()):
            rows = jacobian[6 * hand : 6 * hand + 6]
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            rows[:3] -= cross @ rows[3:]
            rows *= self.moved_by[hand]
        self.jacobian: Array = jacobian

    def error(self, rotations: Array, positions: Array) -> Array:
        """(6 h,) displacement from the present poses to the given ones: offset [m] over rotation vector [rad]."""
        turns = rotations @ self.rotations.transpose(0, 2, 1)
        angles = np.array([pin.log3(turn) for turn in turns])
        error: Array = np.hstack([positions - self.positions, angles]).ravel()
        return error


def turned(rotations: Array, angles: Array) -> Array:
    """(h, 3, 3) orientations turned by rotation vectors (h, 3) in world axes [rad]."""
    pairs = zip(rotations, angles, strict=True)
    return np.array([pin.exp3(angle) @ rotation for rotation, angle in pairs])
