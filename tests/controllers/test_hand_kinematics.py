"""What is compiled of the hands' kinematics says what pinocchio says."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import seven_axes
from driving import model

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.hands import Hands, displacement, turned

ROUNDING = 1e-12


def robot_named(name: str) -> RobotModel:
    return seven_axes.cell().robots["fr"] if name == "seven" else model(name)


@pytest.mark.parametrize("name", ["fr", "gr", "dawm", "seven"])
def test_poses_and_jacobian_of_all_hands_are_pinocchios(name: str) -> None:
    robot = robot_named(name)
    hands, data = Hands(robot), robot.model.createData()
    random = np.random.default_rng(0)
    for _ in range(20):
        q = random.uniform(robot.lower, robot.upper)
        hands.update(q)
        pin.computeJointJacobians(robot.model, data, q)
        expected = []
        for hand, rotation, position in zip(robot.hands, hands.rotations, hands.positions, strict=True):
            frame = robot.frame_of(hand)
            placed = pin.updateFramePlacement(robot.model, data, frame)
            np.testing.assert_allclose(rotation, placed.rotation, atol=ROUNDING)
            np.testing.assert_allclose(position, placed.translation, atol=ROUNDING)
            expected.append(
                pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            )
        np.testing.assert_allclose(hands.jacobian, np.vstack(expected), atol=ROUNDING)


def test_placing_leaves_the_jacobian_as_it_is() -> None:
    robot = model("gr")
    hands = Hands(robot)
    hands.update(robot.home)
    before = hands.jacobian
    hands.place(robot.home + 0.1)
    np.testing.assert_array_equal(hands.jacobian, before)
    np.testing.assert_allclose(hands.positions[0], robot.forward(robot.home + 0.1)[:3, 3], atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, 2.0, np.pi - 1e-5])
def test_turning_and_what_turns_back_are_pinocchios(angle: float) -> None:
    random = np.random.default_rng(1)
    axes = np.array([pin.exp3(random.normal(size=3)) for _ in range(2)])
    ways = random.normal(size=(2, 3))
    ways *= angle / np.linalg.norm(ways, axis=1)[:, None]
    there = turned(axes, ways)
    for one, way, other in zip(axes, ways, there, strict=True):
        np.testing.assert_allclose(other, pin.exp3(way) @ one, atol=ROUNDING)
    positions = random.normal(size=(2, 2, 3))
    found = displacement(axes, positions[0], there, positions[1])
    np.testing.assert_allclose(found[:, :3], positions[1] - positions[0], atol=ROUNDING)
    np.testing.assert_allclose(found[:, 3:], ways, atol=1e-9)


def test_half_a_turn_is_told_as_one() -> None:
    axes = np.eye(3)[None]
    around = np.diag([-1.0, -1.0, 1.0])[None]
    found = displacement(axes, np.zeros((1, 3)), around, np.zeros((1, 3)))
    assert np.linalg.norm(found[0, 3:]) == pytest.approx(np.pi)
