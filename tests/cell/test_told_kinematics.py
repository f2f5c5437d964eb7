"""The kinematics that clients are told place every frame where the model and the URDF do."""

from __future__ import annotations

import numpy as np
import pytest
from urdf_kinematics import UrdfKinematics

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.codec import from_map, line_to_map, to_line
from deltaq_protocol.messages import Description, RobotKinematics


def placed(told: RobotKinematics, units: tuple[str, ...], frame: str, q: np.ndarray) -> np.ndarray:
    """A frame's pose as a client would place it, by the words of the messages alone."""
    poses: list[np.ndarray] = []
    for joint, unit, value in zip(told.joints, units, q, strict=True):
        motion, axis = np.eye(4), np.array(joint.axis)
        if unit == "rad":
            x, y, z = axis
            across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            motion[:3, :3] += np.sin(value) * across + (1 - np.cos(value)) * across @ across
        else:
            motion[:3, 3] = value * axis
        before = poses[joint.parent] if joint.parent >= 0 else np.eye(4)
        poses.append(before @ np.array(joint.T_parent_joint) @ motion)
    carried = told.frames[frame]
    return (poses[carried.joint] if carried.joint >= 0 else np.eye(4)) @ np.array(carried.T_joint_frame)


@pytest.mark.parametrize("cell", ["lab", "dawm"])
def test_a_client_that_reads_neither_yaml_nor_urdf_places_every_frame(cell: str) -> None:
    model = CellModel.load(cell)
    heard = from_map(Description, line_to_map(to_line(model.description_message())))
    for name, robot in model.robots.items():
        told, rng = heard.kinematics[name], np.random.default_rng(1)
        camera = () if robot.description.camera is None else ("camera",)
        assert set(told.frames) == {"tool", *robot.hands, *camera}
        for q in rng.uniform(robot.lower, robot.upper, (5, robot.n)):
            for frame in (*robot.hands, "tool"):
                T_world_frame = placed(told, heard.robots[name].units, frame, q)
                np.testing.assert_allclose(T_world_frame, robot.forward(q, frame), atol=1e-12)
            for frame in camera:
                T_world_frame = placed(told, heard.robots[name].units, frame, q)
                np.testing.assert_allclose(T_world_frame, robot.camera_pose(q), atol=1e-12)


def test_and_so_does_the_urdf_itself() -> None:
    model = CellModel.load("lab")
    for robot in model.robots.values():
        description = robot.description
        by_hand = UrdfKinematics(description, robot.urdf)
        for q in np.random.default_rng(2).uniform(robot.lower, robot.upper, (5, robot.n)):
            np.testing.assert_allclose(by_hand.at(q, description.tool.frame), robot.forward(q), atol=1e-9)
            if description.camera is not None:
                pose = by_hand.at(q, description.camera.pose)
                np.testing.assert_allclose(pose, robot.camera_pose(q), atol=1e-9)
