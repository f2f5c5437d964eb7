"""Everything that one evaluation of the control law needs of a robot, from one pass through its joints.

All Jacobians come from one (6, n) matrix: the joints' velocity fields at the world's origin, so that the
linear Jacobian of any point o carried by the last joint is `linear - [o]x angular`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel

Array = NDArray[np.float64]


class Kinematics:
    """A robot with one point of interest, carried by one of its joints.

    Args:
        robot: model of the robot.
        point: the frame that `rotation` and `position` tell.

    Attributes:
        rotation: (3, 3) axes of the frame in the world, after `update`.
        position: (3,) origin of the frame in the world [m].
        linear: (3, n) velocity of the frame's body at the world's origin, per joint rate.
        angular: (3, n) angular velocity of the frame's body, per joint rate.
        twists: (6, n) both of them, linear over angular.
        columns: (6, n) the same for whatever each joint carries.
        data: pinocchio's data, joint placements filled in.
        last: index of the outermost joint that moves the frame.
    """

    def __init__(self, robot: RobotModel, point: Literal["tool", "camera"]) -> None:
        self.model = robot.model
        self.data = self.model.createData()
        frame = self.model.frames[self.model.getFrameId(f"deltaq_{point}")]
        self._joint = int(frame.parentJoint)
        self.last = self._joint - 1
        self._offset_rotation: Array = np.array(frame.placement.rotation)
        self._offset: Array = np.array(frame.placement.translation)
        others = ~joints_that_move(robot, np.array([self._joint]))[0]
        self._others = others if others.any() else None
        self.update(robot.home)

    def update(self, q: Array) -> None:
        """Place the robot at configuration `q` (n,)."""
        columns: Array = pin.computeJointJacobians(self.model, self.data, q)
        carrier = self.data.oMi[self._joint]
        turn = carrier.rotation
        self.rotation: Array = turn @ self._offset_rotation
        self.position: Array = turn @ self._offset + carrier.translation
        self.columns = columns
        if self._others is not None:
            columns = columns.copy()
            columns[:, self._others] = 0.0
        self.twists: Array = columns
        self.linear: Array = columns[:3]
        self.angular: Array = columns[3:]

    def jacobian(self) -> Array:
        """(6, n) Jacobian of the frame's origin, linear over angular, world axes."""
        return np.vstack([self.at_point(self.position), self.angular])

    def at_point(self, point: Array) -> Array:
        """(3, n) linear Jacobian of the point of the frame's body that lies at `point` (3,) in the world."""
        velocity: Array = self.linear - skew(point) @ self.angular
        return velocity


def joints_that_move(robot: RobotModel, carriers: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(m, n) whether joint j moves what each of `carriers` (m,), counted from 1, carries."""
    moves = np.zeros((len(carriers), robot.n), dtype=np.bool_)
    for row, carrier in enumerate(carriers.tolist()):
        for joint in robot.model.supports[carrier]:
            if joint > 0:
                moves[row, joint - 1] = True
    return moves


def skew(v: Array) -> Array:
    """(3, 3) matrix of the cross product: `skew(v) @ w = v x w`."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
