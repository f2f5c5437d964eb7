"""Everything that one evaluation of the control law needs of a robot, from one pass through its joints.

All Jacobians come from one (6, n) matrix: the joints' velocity fields at the world's origin, so that the
linear Jacobian of any point o carried by the last joint is `linear - [o]x angular`. pinocchio's data is read in place,
by views that are made once.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array, Indices


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


# Poses of a model's joints, compiled: pinocchio's results, in arrays for compiled functions.
#
# Reading the frames of pinocchio's data one by one costs several times their computation. The gate's kernel places
# joints likewise, in arrays of its own (`deltaq_cell.kernel.place`). Machine code is kept package by package, so a
# compiled function calls none of another package.


class JointTree(NamedTuple):
    """Joints as they carry one another, each after the one that carries it.

    Attributes:
        parents: (n,) the joint that carries each, -1 for the world.
        rotations: (n, 3, 3) of each joint's frame in that of the one before, at zero.
        translations: (n, 3) likewise [m].
        axes: (n, 3) unit vectors in the joints' own frames.
        revolute: (n,) False for prismatic ones.
    """

    parents: Indices
    rotations: Array
    translations: Array
    axes: Array
    revolute: NDArray[np.bool_]


def joint_tree(model: Any) -> JointTree:
    """The joints of a pinocchio model, each revolute or prismatic."""
    data, n = model.createData(), model.nv
    pin.computeJointJacobians(model, data, pin.neutral(model))
    own = [
        np.reshape(pin.getJointJacobian(model, data, joint + 1, pin.LOCAL), (6, n))[:, joint]
        for joint in range(n)
    ]
    revolute = np.array([bool(column[3:].any()) for column in own])
    places = [model.jointPlacements[joint + 1] for joint in range(n)]
    return JointTree(
        np.array([int(model.parents[joint + 1]) - 1 for joint in range(n)], dtype=np.intp),
        np.array([place.rotation for place in places]),
        np.array([place.translation for place in places]),
        np.array([column[3:] if turns else column[:3] for column, turns in zip(own, revolute, strict=True)]),
        revolute,
    )


@compiled
def placed_joints(tree: JointTree, q: Array) -> tuple[Array, Array]:
    """The joints at `q` (n,) [rad or m].

    Returns:
        (4 n, 3) placements, as `kinematics.placement_views` has them, and (6, n) unit twists of the joints at the
        world's origin, linear over angular.
    """
    n = len(q)
    placements, columns = np.empty((4 * n, 3)), np.zeros((6, n))
    for joint in range(n):
        first, before = 4 * joint, 4 * tree.parents[joint]
        here, shift = tree.rotations[joint], tree.translations[joint]
        x, y, z = tree.axes[joint, 0], tree.axes[joint, 1], tree.axes[joint, 2]
        cos, sin = math.cos(q[joint]), math.sin(q[joint])
        for row in range(3):
            if before < 0:
                r0, r1, r2, at = here[row, 0], here[row, 1], here[row, 2], shift[row]
            else:
                a, b, c = placements[before, row], placements[before + 1, row], placements[before + 2, row]
                r0 = a * here[0, 0] + b * here[1, 0] + c * here[2, 0]
                r1 = a * here[0, 1] + b * here[1, 1] + c * here[2, 1]
                r2 = a * here[0, 2] + b * here[1, 2] + c * here[2, 2]
                at = placements[before + 3, row] + a * shift[0] + b * shift[1] + c * shift[2]
            along = r0 * x + r1 * y + r2 * z
            if tree.revolute[joint]:
                # a row r turns to cos r + sin (r x axis) + (1 - cos) (r . axis) axis
                rest = (1.0 - cos) * along
                placements[first, row] = cos * r0 + sin * (r1 * z - r2 * y) + rest * x
                placements[first + 1, row] = cos * r1 + sin * (r2 * x - r0 * z) + rest * y
                placements[first + 2, row] = cos * r2 + sin * (r0 * y - r1 * x) + rest * z
                columns[3 + row, joint] = along
            else:
                placements[first, row], placements[first + 1, row], placements[first + 2, row] = r0, r1, r2
                at += q[joint] * along
                columns[row, joint] = along
            placements[first + 3, row] = at
        if tree.revolute[joint]:
            a, b, c = placements[first + 3, 0], placements[first + 3, 1], placements[first + 3, 2]
            x, y, z = columns[3, joint], columns[4, joint], columns[5, joint]
            columns[0, joint], columns[1, joint], columns[2, joint] = (
                b * z - c * y,
                c * x - a * z,
                a * y - b * x,
            )
    return placements, columns
