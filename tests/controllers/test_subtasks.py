import math
import re

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, with_camera

from deltaq_cell.description import Camera, Pose
from deltaq_controllers.camera.follower import CameraFollower
from deltaq_controllers.camera.subtasks import (
    LEVEL_RATIO,
    roll,
    roll_effect,
    turn_to_level,
    turns_about_view_axis,
    view_distance_field,
)
from deltaq_controllers.kinematics import Kinematics

LEVEL = Camera(pose=Pose(position_m=(0, 0, 0.17), rpy_deg=(0, 0, 180)))
OFF_AXIS = Camera(pose=Pose(position_m=(0.06, 0, 0.17), rpy_deg=(0, 0, 180)))
TILTED = Camera(pose=Pose(position_m=(0.02, 0.01, 0.17), rpy_deg=(15, -10, 160)))


def urdf_with_a6_turned_round() -> str:
    """The KR 16 with an A6 that turns about its view axis the other way."""
    text = lab().robots["fr"].urdf
    joint = re.search(r'<joint name="a6".*?</joint>', text, re.DOTALL)
    assert joint is not None
    turned = joint.group().replace('xyz="-1 0 0"', 'xyz="1 0 0"')
    assert turned != joint.group()
    return text.replace(joint.group(), turned)


def test_the_view_distance_field_descends_the_squared_error() -> None:
    kinematics = Kinematics(lab().robots["fr"], "camera")
    focus, desired, gain = np.array([-0.4, -1.3, 1.2]), 1.0, 3.0
    q = np.deg2rad([10.0, -100, 90, 20, 30, -15])

    def cost(q: np.ndarray) -> float:
        kinematics.update(q)
        return 0.5 * gain * (float(np.linalg.norm(focus - kinematics.position)) - desired) ** 2

    downhill = [-(cost(q + d) - cost(q - d)) / 2e-6 for d in 1e-6 * np.eye(6)]
    kinematics.update(q)
    away = focus - kinematics.position
    distance = float(np.linalg.norm(away))
    approach = kinematics.jacobian()[:3].T @ (away / distance)
    np.testing.assert_allclose(
        view_distance_field(gain, approach, distance - desired), downhill, rtol=1e-6, atol=1e-8
    )


@pytest.mark.parametrize("camera", [LEVEL, OFF_AXIS, TILTED])
@pytest.mark.parametrize("turned", [False, True])
def test_the_effect_of_the_last_joint_on_the_roll_is_its_derivative(
    camera: Camera, turned: bool, random: np.random.Generator
) -> None:
    robot = with_camera(camera, urdf_with_a6_turned_round() if turned else None)
    kinematics = Kinematics(robot, "camera")
    for _ in range(10):
        q = random.uniform(-1.0, 1.0, 6)

        def roll_at(angle: float, q: np.ndarray = q) -> float:
            kinematics.update(np.append(q[:5], angle))
            return roll(kinematics.rotation)

        difference = roll_at(q[5] + 1e-6) - roll_at(q[5] - 1e-6)
        numeric = math.remainder(difference, 2 * math.pi) / 2e-6
        kinematics.update(q)
        effect = roll_effect(kinematics.rotation, kinematics.angular[:, -1])
        if np.linalg.norm(kinematics.rotation[2, :2]) < LEVEL_RATIO:  # looks up or down: there is no roll
            assert effect == 0.0
            continue
        assert effect == pytest.approx(numeric, rel=1e-5, abs=1e-6)
        if camera is LEVEL:
            assert effect == pytest.approx(-1.0 if turned else 1.0)


def test_a_camera_looking_straight_down_is_not_levelled() -> None:
    looking_down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    assert roll_effect(looking_down, np.array([0.0, 0.0, -1.0])) == 0.0
    assert turn_to_level(looking_down, np.array([0.0, 0.0, -1.0]), 0.0, -6.0, 6.0) == 0.0


def test_the_roll_joint_takes_the_long_direction_if_its_limit_blocks_the_short_one() -> None:
    kinematics = Kinematics(lab().robots["fr"], "camera")
    kinematics.update(np.deg2rad([0.0, -90, 90, 0, 0, 0]))
    axis, limit = kinematics.angular[:, -1], math.radians(345.0)
    for short in (2.0, -2.0):
        angle = np.sign(short) * math.radians(300.0)
        rotation = kinematics.rotation @ np.array(
            [[math.cos(short), -math.sin(short), 0], [math.sin(short), math.cos(short), 0], [0, 0, 1.0]]
        )
        assert turn_to_level(rotation, axis, 0.0, -limit, limit) == pytest.approx(short)
        assert turn_to_level(rotation, axis, angle, -limit, limit) == pytest.approx(
            short - math.copysign(2 * math.pi, short)
        )


@pytest.mark.parametrize(("camera", "expected"), [(LEVEL, True), (OFF_AXIS, False), (TILTED, False)])
def test_only_a_lens_on_the_axis_of_the_last_joint_is_turned_by_it_alone(
    camera: Camera, expected: bool
) -> None:
    k = Kinematics(with_camera(camera), "camera")
    assert turns_about_view_axis(k.rotation, k.position, k.angular[:, -1], k.linear[:, -1]) is expected


@pytest.mark.parametrize("camera", [LEVEL, OFF_AXIS, TILTED])
@pytest.mark.parametrize("turned", [False, True])
def test_a_picture_upside_down_is_levelled_while_the_view_stays_on_the_focus(
    camera: Camera, turned: bool
) -> None:
    robot = with_camera(camera, urdf_with_a6_turned_round() if turned else None)
    follower = CameraFollower(robot, None, CYCLE_S)
    q, dq = np.deg2rad([0.0, -110, 110, 0, 20, 170]), np.zeros(6)
    pose = robot.camera_pose(q)
    focus = pose[:3, 3] + 1.2 * pose[:3, 2]
    assert abs(roll(pose)) > 1.0
    angles = []
    for cycle in range(250):
        dq = follower.increment(q, dq, focus, None, 1.2, cycle * CYCLE_S)
        q = q + dq
        pose = robot.camera_pose(q)
        to_focus = focus - pose[:3, 3]
        angles.append(math.degrees(math.acos(min(1.0, pose[:3, 2] @ to_focus / np.linalg.norm(to_focus)))))
    assert abs(roll(pose)) < 1e-3
    assert max(angles) < 2.0
