"""Constraint tracking: hands that stay, whatever the base does; and the kinematics of many configurations at once."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Pose
from deltaq_cell.robot import RobotModel
from deltaq_controllers.batch import BatchKinematics
from deltaq_controllers.inverse.any_arm import AnyArm
from deltaq_controllers.inverse.kr16 import Kr16Inverse
from deltaq_controllers.inverse.titan import TitanInverse
from deltaq_controllers.inverse.tracking import ConstraintTracker

LAB, DAWM = CellModel.load("lab"), CellModel.load("dawm")
ROBOTS = {"dawm": DAWM.robots["dawm"], "gr": LAB.robots["gr"], "fr": LAB.robots["fr"]}


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> RobotModel:
    return ROBOTS[request.param]


def test_many_configurations_are_placed_as_pinocchio_places_one(robot: RobotModel) -> None:
    kinematics = BatchKinematics(robot)
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (20, robot.n))
    frames = kinematics.frames(q)
    data = robot.model.createData()
    for row in range(20):
        pin.forwardKinematics(robot.model, data, q[row])
        for joint in range(robot.n):
            placed = data.oMi[joint + 1]
            np.testing.assert_allclose(frames.rotation[joint][row], placed.rotation, atol=1e-13)
            np.testing.assert_allclose(frames.position[joint][row], placed.translation, atol=1e-13)
    for hand, (joint, _, offset) in zip(robot.hands, kinematics.hands, strict=True):
        points = frames.position[joint] + frames.rotation[joint] @ offset
        J = kinematics.jacobian(frames, joint, points)
        for row in range(20):
            np.testing.assert_allclose(J[row], robot.jacobian(q[row], hand), atol=1e-13)


def test_the_dawm_keeps_five_of_17_joints_free_the_gantry_robot_three_and_the_floor_robot_none() -> None:
    trackers = {name: ConstraintTracker(robot) for name, robot in ROBOTS.items()}
    assert [len(trackers[name].base) for name in ("dawm", "gr", "fr")] == [5, 3, 0]
    names = [ROBOTS["dawm"].joint_names[joint] for joint in trackers["dawm"].base]
    assert names == ["torso", "left_yaw", "left_pitch", "right_yaw", "right_pitch"]
    assert all(isinstance(arm.solver, TitanInverse) for arm in trackers["dawm"].arms)
    assert isinstance(trackers["gr"].arms[0].solver, Kr16Inverse)


def test_the_hands_stay_to_1e_12_while_the_base_moves(robot: RobotModel) -> None:
    tracker = ConstraintTracker(robot)
    poses = tracker.hands(robot.home)
    reach = 0.1 * (robot.upper - robot.lower)[tracker.base]
    base = robot.home[tracker.base] + np.random.default_rng(2).uniform(-reach, reach, (500, len(reach)))
    q = tracker.track(base, poses, robot.home)
    there = np.isfinite(q).all(axis=1)
    assert there.mean() > 0.2
    for row in q[there]:
        assert np.abs(tracker.hands(row) - poses).max() < 1e-12
        assert np.all((row >= robot.lower) & (row <= robot.upper))
    np.testing.assert_array_equal(q[there][:, tracker.base], base[there])


def test_every_branch_that_is_solved_puts_its_hand_where_it_shall_be() -> None:
    robot = ROBOTS["dawm"]
    tracker = ConstraintTracker(robot)
    poses = tracker.hands(robot.home)
    base = np.random.default_rng(3).uniform(robot.lower, robot.upper, (200, 17))[:, tracker.base]
    for arm, pose, branches in zip(tracker.arms, poses, tracker.solve(base, poses), strict=True):
        for row, branch in np.argwhere(branches.exists)[:300]:
            q = np.zeros(17)
            q[tracker.base], q[arm.joints] = base[row], branches.q[row, branch]
            assert np.abs(robot.forward(q, arm.hand) - pose).max() < 1e-12


def test_the_branch_nearest_to_the_reference_is_taken(robot: RobotModel) -> None:
    tracker = ConstraintTracker(robot)
    for reference in np.random.default_rng(4).uniform(robot.lower, robot.upper, (50, robot.n)):
        (q,) = tracker.track(reference[None, tracker.base], tracker.hands(reference), reference)
        np.testing.assert_allclose(q, reference, atol=1e-6)


def test_a_base_outside_its_limits_and_a_hand_out_of_reach_are_told() -> None:
    robot = ROBOTS["gr"]
    tracker = ConstraintTracker(robot)
    base = np.array([robot.home[:3], robot.upper[:3] + 0.01])
    q = tracker.track(base, tracker.hands(robot.home), robot.home)
    assert np.isfinite(q[0]).all()
    assert np.isnan(q[1]).all()
    far = tracker.hands(robot.home)
    far[0, 0, 3] += 10.0
    assert np.isnan(tracker.track(base, far, robot.home)).all()


def test_a_base_pose_is_part_of_it() -> None:
    description = LAB.description.robots["fr"].model_copy(
        update={"base": Pose(position_m=(1, 2, 0.5), rpy_deg=(10, -20, 40))}
    )
    robot = RobotModel(description, "fr")
    tracker = ConstraintTracker(robot)
    (q,) = tracker.track(np.zeros((1, 0)), tracker.hands(robot.home), robot.home)
    np.testing.assert_allclose(q, robot.home, atol=1e-9)


def test_an_arm_that_is_nearly_a_kr16_is_not_taken_for_one() -> None:
    description = LAB.description.robots["fr"]
    urdf = ROBOTS["fr"].urdf.replace('xyz="0.68 0 0"', 'xyz="0.58 0 0"')
    assert urdf != ROBOTS["fr"].urdf
    robot = RobotModel(description, "fr", urdf=urdf)
    tracker = ConstraintTracker(robot)
    assert isinstance(tracker.arms[0].solver, AnyArm)
    (q,) = tracker.track(np.zeros((1, 0)), tracker.hands(robot.home), robot.home)
    np.testing.assert_allclose(q, robot.home, atol=1e-9)
