"""A robot's hands: where they are, how they move with the joints, and which joints carry which."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
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
        self._read_poses()
        self.jacobian: Array = _stacked(columns, self.positions, self.moved_by)

    def place(self, q: Array) -> None:
        """Place the robot at `q` (n,) [rad or m] without updating `jacobian`."""
        pin.forwardKinematics(self._model, self._data, q)
        self._read_poses()

    def _read_poses(self) -> None:
        poses = [pin.updateFramePlacement(self._model, self._data, frame) for frame in self._frames]
        self.rotations: Array = np.array([pose.rotation for pose in poses])
        self.positions: Array = np.array([pose.translation for pose in poses])

    def error(self, rotations: Array, positions: Array) -> Array:
        """(6 h,) displacement from the present poses to the given ones: offset [m] over rotation vector [rad]."""
        turns = rotations @ self.rotations.transpose(0, 2, 1)
        angles = np.array([pin.log3(turn) for turn in turns])
        error: Array = np.hstack([positions - self.positions, angles]).ravel()
        return error


@compiled
def _stacked(columns: Array, positions: Array, moved_by: NDArray[np.bool_]) -> Array:
    """(6 h, n) velocities (6, n) at the world's origin, taken to each hand's; zero for joints that do not move it."""
    hands, n = moved_by.shape
    jacobian = np.zeros((6 * hands, n))
    for hand in range(hands):
        x, y, z = positions[hand]
        for joint in range(n):
            if moved_by[hand, joint]:
                wx, wy, wz = columns[3, joint], columns[4, joint], columns[5, joint]
                jacobian[6 * hand, joint] = columns[0, joint] + wy * z - wz * y
                jacobian[6 * hand + 1, joint] = columns[1, joint] + wz * x - wx * z
                jacobian[6 * hand + 2, joint] = columns[2, joint] + wx * y - wy * x
                for axis in range(3, 6):
                    jacobian[6 * hand + axis, joint] = columns[axis, joint]
    return jacobian


def turned(rotations: Array, angles: Array) -> Array:
    """(h, 3, 3) orientations turned by rotation vectors (h, 3) in world axes [rad]."""
    pairs = zip(rotations, angles, strict=True)
    return np.array([pin.exp3(angle) @ rotation for rotation, angle in pairs])
