"""A robot's kinematics as a client is told them: numbers only, so that it needs neither YAML nor URDF."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from deltaq_cell.robot import RobotModel
from deltaq_protocol.messages import CarriedFrame, JointPlacement, RobotKinematics, Row


def told_kinematics(robot: RobotModel) -> RobotKinematics:
    """Where each joint and each carried frame (`tool`, `camera`, hands) is placed, in joint order."""
    names = (*robot.hands, "tool", *(("camera",) if robot.description.camera is not None else ()))
    frames = {name: robot.model.frames[robot.frame_of(name)] for name in names}
    return RobotKinematics(
        joints=tuple(_joint(robot, index) for index in range(robot.n)),
        frames={
            name: CarriedFrame(joint=int(frame.parentJoint) - 1, T_joint_frame=_rows(frame.placement))
            for name, frame in frames.items()
        },
    )


def joint_axis(robot: RobotModel, index: int) -> tuple[float, float, float]:
    """The axis of a joint in its own frame: a unit vector, along which or about which it moves."""
    model = robot.model
    # at any configuration: in its own frame a joint's axis stands still
    J = pin.computeJointJacobian(model, model.createData(), pin.neutral(model), index + 1)
    motion = np.reshape(J, (6, -1))[:, index]  # of a robot with one joint pinocchio gives a vector
    x, y, z = np.asarray(motion[3:] if robot.revolute[index] else motion[:3]).round(15).tolist()
    return x, y, z


def _joint(robot: RobotModel, index: int) -> JointPlacement:
    return JointPlacement(
        parent=int(robot.model.parents[index + 1]) - 1,
        T_parent_joint=_rows(robot.model.jointPlacements[index + 1]),
        axis=joint_axis(robot, index),
    )


def _rows(pose: pin.SE3) -> tuple[Row, Row, Row, Row]:
    first, second, third, last = (tuple(row) for row in pose.homogeneous.tolist())
    return first, second, third, last
