"""Constraint tracking: hands that stay, whatever the base does; and the kinematics of many configurations at once."""

import numpy as np
import pinocchio as pin
import published_arms
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Pose
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.advisor import Progress, advise
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import AdvisorError, AdvisorProblem
from deltaq_controllers.advisor.session import Answered
from deltaq_controllers.batch import BatchKinematics
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.inverse.any_arm import AnyArm
from deltaq_controllers.inverse.kr16 import Kr16Inverse
from deltaq_controllers.inverse.titan import TitanInverse
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.modes.advisor import AdvisorMode, tracker_of
from deltaq_controllers.modes.teleoperator import MODES, Teleoperator
from deltaq_controllers.operated.reach import ReachPlanner
from deltaq_deploy.command.advice import AdviceRequest, advice
from deltaq_protocol.driving import DrivingMode, OperatorCommand

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


def test_every_solved_branch_reaches_its_hand_pose() -> None:
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


def test_a_base_beyond_its_limits_and_a_hand_out_of_reach_are_reported() -> None:
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


def test_an_arm_similar_to_a_kr16_is_not_treated_as_one() -> None:
    description = LAB.description.robots["fr"]
    urdf = ROBOTS["fr"].urdf.replace('xyz="0.68 0 0"', 'xyz="0.58 0 0"')
    assert urdf != ROBOTS["fr"].urdf
    robot = RobotModel(description, "fr", urdf=urdf)
    tracker = ConstraintTracker(robot)
    assert isinstance(tracker.arms[0].solver, AnyArm)
    (q,) = tracker.track(np.zeros((1, 0)), tracker.hands(robot.home), robot.home)
    np.testing.assert_allclose(q, robot.home, atol=1e-9)


# Two published arms in all modes and with the advisor: a UR10, and a Panda with a joint to spare.


CELL = published_arms.cell()
UR, PANDA = CELL.robots["ur"], CELL.robots["panda"]
CYCLE_S = CELL.description.cycle_s
# both homes are symmetric, and the Panda's singular for some joints
START = {"ur": UR.home + 0.1, "panda": PANDA.home + np.array([0.1, 0.1, 0.3, 0.1, 0.2, 0.1, 0.1])}


def driven(name: str, command: OperatorCommand, seconds: float = 1.0) -> np.ndarray:
    """Setpoints of a robot to which all that is asked for is done."""
    robot = CELL.robots[name]
    assert command.mode is not None
    teleoperator = Teleoperator(robot, CYCLE_S, command.mode)
    q, way = START[name], [START[name]]
    teleoperator.command = command
    for cycle in range(round(seconds / CYCLE_S)):
        q = q + teleoperator.increment(View(RobotView(cycle, cycle * CYCLE_S, q, q)))
        way.append(q)
    return np.array(way)


@pytest.mark.parametrize("name", ["ur", "panda"])
@pytest.mark.parametrize("mode", [DrivingMode.DECOUPLED, DrivingMode.COUPLED])
def test_the_hand_moves_along_its_line_without_rotation(name: str, mode: DrivingMode) -> None:
    way = driven(name, OperatorCommand({"z": -0.05}, mode))
    T = [CELL.robots[name].forward(q) for q in way]
    moved = np.array([pose[:3, 3] - T[0][:3, 3] for pose in T])
    assert moved[-1, 2] < -0.02
    assert np.abs(moved[:, :2]).max() < 1e-4
    assert max(np.abs(pose[:3, :3] - T[0][:3, :3]).max() for pose in T) < 1e-4


@pytest.mark.parametrize("name", ["ur", "panda"])
def test_each_joint_is_driven_by_itself(name: str) -> None:
    for joint in CELL.robots[name].joint_names[:3]:
        way = driven(name, OperatorCommand({joint: 0.05}, DrivingMode.JOINT), 0.5)
        moved = np.abs(way[-1] - way[0]) > 1e-3
        assert [CELL.robots[name].joint_names[k] for k in np.flatnonzero(moved)] == [joint]


def test_a_panda_moves_itself_and_not_its_hand() -> None:
    way = driven("panda", OperatorCommand({"panda_joint3": 0.1}, DrivingMode.SELF_MOTION))
    T = [PANDA.forward(q) for q in way]
    assert np.abs(way[-1] - way[0])[2] > 0.02
    assert max(np.abs(pose - T[0]).max() for pose in T) < 1e-4


def test_a_ur_refuses_self_motion_with_a_reason() -> None:
    with pytest.raises(
        ControllerError, match="self-motion needs more than 6 joints for 1 hand, robot 'ur' has 6"
    ):
        Teleoperator(UR, CYCLE_S, DrivingMode.SELF_MOTION)
    with pytest.raises(ControllerError, match="mode advisor needs a redundant robot, 'ur' is not"):
        tracker_of(UR)
    with pytest.raises(AdvisorError, match="'ur' is not redundant"):
        AdvisorProblem(CELL, "ur", ConstraintTracker(UR).hands(UR.home))


@pytest.mark.long
def test_a_panda_reaches_an_option_with_its_hand_in_place() -> None:
    tracker, start = ConstraintTracker(PANDA), START["panda"]
    problem = AdvisorProblem(CELL, "panda", tracker.hands(start), None, tracker)
    exact = ExactClearance(CELL, "panda")
    found = advise(problem, start, generator=np.random.default_rng(0), exact=exact)
    best = found[0]
    assert best.path is not None
    assert best.energy < best.energy_here
    for q in best.path:
        assert np.abs(PANDA.forward(q) - PANDA.forward(start)).max() < 1e-9
        assert np.all((q >= PANDA.lower) & (q <= PANDA.upper))
        assert exact.keeps(q[None])
    answered = Answered(tracker, Progress("finding paths", 1.0, best.energy, 0, tuple(found)))
    modes = {**MODES, DrivingMode.ADVISOR: lambda robot: AdvisorMode(robot, CYCLE_S, answered)}
    teleoperator = Teleoperator(PANDA, CYCLE_S, DrivingMode.ADVISOR, modes=modes)
    teleoperator.command = OperatorCommand(option=1)
    q, off = start, 0.0
    for cycle in range(round(60.0 / CYCLE_S)):
        q = q + teleoperator.increment(View(RobotView(cycle, cycle * CYCLE_S, q, q)))
        off = max(off, float(np.abs(PANDA.forward(q) - PANDA.forward(start)).max()))
        if teleoperator.arrived_at == 1:
            break
    assert teleoperator.arrived_at == 1
    assert off < 1e-4


@pytest.mark.long
@pytest.mark.nightly
def test_a_ur_is_offered_its_other_branches_and_paths_to_another_pose(tmp_path) -> None:
    file = tmp_path / "arms.yaml"
    file.write_text(published_arms.description())
    leaving = advice(AdviceRequest(cell=str(file), robot="ur", offline=True, hands_may_leave=True))
    assert not leaving.word
    assert sum(option.hands_leave for option in leaving.options) >= 1
    for option in leaving.options:
        np.testing.assert_allclose(UR.forward(option.q), UR.forward(UR.home), atol=1e-9)
    pose = (0.9, 0.2, 0.6, 180.0, 0.0, 0.0)
    elsewhere = advice(AdviceRequest(cell=str(file), robot="ur", offline=True, hands={"tool": pose}))
    assert elsewhere.options
    for option in elsewhere.options:
        np.testing.assert_allclose(UR.forward(option.q)[:3, 3], pose[:3], atol=1e-9)


@pytest.mark.parametrize("name", ["ur", "panda"])
def test_a_path_to_a_hand_pose_is_planned_and_an_unreachable_pose_reported(name: str) -> None:
    robot = CELL.robots[name]
    planner = ReachPlanner(CELL, name)
    T = robot.forward(START[name])
    others = {other: model.home for other, model in CELL.robots.items() if other != name}
    x, y, z = (T[:3, 3] + (0.0, 0.05, 0.05)).tolist()
    quaternion = pin.Quaternion(T[:3, :3])
    turned = (quaternion.w, quaternion.x, quaternion.y, quaternion.z)
    planned = planner.plan(START[name], others, "", (x, y, z), turned)
    end = np.array(planned.way.q)
    np.testing.assert_allclose(robot.forward(end)[:3, 3], (x, y, z), atol=1e-4)
    with pytest.raises(ControllerError, match="out of reach"):
        planner.plan(START[name], others, "", (9.0, 0.0, 0.0), turned)
