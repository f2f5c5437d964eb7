"""Everything that one evaluation of the control law needs of a robot, from one pass through its joints.

All Jacobians come from one (6, n) matrix: the joints' velocity fields at the world's origin, so that the
linear Jacobian of any point o carried by the last joint is `linear - [o]x angular`. pinocchio's data is read in place,
by views that are made once.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array


class Kinematics:
    """A robot with one point of interest, carried by one of its joints.

    Args:
        robot: model of the robot.
        point: the frame that `rotation` and `position` describe.

    Attributes:
        rotation: (3, 3) axes of the frame in the world, after `update`.
        position: (3,) origin of the frame in the world [m].
        linear: (3, n) velocity of the frame's body at the world's origin, per joint rate; a view, as the next three
            are, that the next `update` changes.
        angular: (3, n) angular velocity of the frame's body, per joint rate.
        twists: (6, n) both of them, linear over angular.
        columns: (6, n) unit twist of each joint, for any body that it carries.
        model, data: pinocchio's, joint placements filled in.
        last: index of the outermost joint that moves the frame.
    """

    def __init__(self, robot: RobotModel, point: Literal["tool", "camera"]) -> None:
        self.model, self.data = robot.model, robot.model.createData()
        self._frame = robot.frame_of(point)
        joint = int(self.model.frames[self._frame].parentJoint)
        self.last = joint - 1
        placed = self.data.oMf[self._frame]
        self._rotation, self._position = placed.rotation, placed.translation
        self.columns: Array = np.reshape(
            self.data.J, (6, -1)
        )  # of a robot with one joint pinocchio has a vector
        moves = joints_that_move(robot, np.array([joint]))[0]
        self._others = None if moves.all() else ~moves
        self.twists: Array = self.columns if self._others is None else np.zeros_like(self.columns)
        self.linear: Array = self.twists[:3]
        self.angular: Array = self.twists[3:]
        self._placements = placement_views(self.data)
        self.update(robot.home)

    def update(self, q: Array) -> None:
        """Place the robot at configuration `q` (n,)."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacement(self.model, self.data, self._frame)
        self.rotation: Array = self._rotation.copy()
        self.position: Array = self._position.copy()
        if self._others is not None:
            self.twists[:] = self.columns
            self.twists[:, self._others] = 0.0

    def placements(self) -> Array:
        """(4 n, 3) where the joints are, as `Spheres.placed` takes them."""
        return np.concatenate(self._placements)

    def origins(self) -> Array:
        """(n, 3) origins of the joints in the world [m]."""
        return np.concatenate(self._placements[1::2])

    def jacobian(self) -> Array:
        """(6, n) Jacobian of the frame's origin, linear over angular, world axes."""
        return np.vstack([self.at_point(self.position), self.angular])

    def at_point(self, point: Array) -> Array:
        """(3, n) linear Jacobian of the point of the frame's body that lies at `point` (3,) in the world."""
        velocity: Array = self.linear - skew(point) @ self.angular
        return velocity


def joints_that_move(robot: RobotModel, carriers: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(m, n) whether joint j moves the bodies on each joint of `carriers` (m,), counted from 1."""
    moves = np.zeros((len(carriers), robot.n), dtype=np.bool_)
    for row, carrier in enumerate(carriers.tolist()):
        for joint in robot.model.supports[carrier]:
            if joint > 0:
                moves[row, joint - 1] = True
    return moves


def placement_views(data: Any) -> list[Array]:
    """Views of where pinocchio's `data` has the joints: of each its axes (3, 3), a row each, and its origin (1, 3).

    One on top of the other they are a (4 n, 3) matrix that takes homogeneous coordinates in the joints' frames into
    the world.
    """
    placed = list(data.oMi)[1:]
    return [view for joint in placed for view in (joint.rotation.T, joint.translation[None])]


def skew(v: Array) -> Array:
    """(3, 3) matrix of the cross product: `skew(v) @ w = v x w`."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
