"""Two hands that hold an object between them, and move it as one."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from driving import CYCLE_S, PlainDrive, model
from held_object_drive import LOST_SHARE, drive
from test_operator_input import Terminal

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.hands import Hands, HeldObject
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.script import Script
from deltaq_controllers.teleoperation import DriveLog
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, Frame, Grip, OperatorCommand

OBJECT, FREE = Grip.OBJECT, Grip.FREE
HANDS_MODES = (DrivingMode.DECOUPLED, DrivingMode.COUPLED)
KEPT_M, KEPT_RAD = 5e-6, 5e-6
BRAKED_M, BRAKED_RAD = 6e-4, 1.2e-3


@pytest.fixture(scope="module")
def dawm() -> RobotModel:
    return model("dawm")


def poses(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    hands = Hands(robot)
    hands.place(q)
    return hands.rotations, hands.positions


def held(mode: DrivingMode = DrivingMode.COUPLED, frame: Frame = Frame.WORLD) -> PlainDrive:
    run = PlainDrive("dawm", mode, frame=frame)
    run.step(OperatorCommand(grip=OBJECT))
    return run


# --- what is refused ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "command", "mode", "told"),
    [
        ("gr", OperatorCommand(), DrivingMode.COUPLED, "robot gr has one hand, and an object is held by two"),
        (
            "dawm",
            OperatorCommand(),
            DrivingMode.JOINT,
            "mode joint moves each joint by itself and would separate",
        ),
        ("dawm", OperatorCommand({"left.x": 0.1}), DrivingMode.COUPLED, "'left.x' moves one hand alone"),
    ],
)
def test_a_motion_that_would_separate_the_hands_is_refused(
    robot: str, command: OperatorCommand, mode: DrivingMode, told: str
) -> None:
    with pytest.raises(ControllerError, match=told):
        Teleoperator(model(robot), CYCLE_S, DrivingMode.COUPLED).check(command, mode, OBJECT)


def test_a_mode_that_would_separate_the_hands_is_refused_during_a_grasp() -> None:
    run = held()
    with pytest.raises(ControllerError, match=r"choose grip free first, or another mode"):
        run.step(OperatorCommand(mode=DrivingMode.JOINT))
    free = PlainDrive("dawm", DrivingMode.JOINT)
    with pytest.raises(ControllerError, match="mode joint"):
        free.step(OperatorCommand(grip=OBJECT))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("- {duration_s: 1, grip: tight}", "grip: Input should be 'free' or 'object'; got 'tight'"),
        ("- {duration_s: 1, grip: object}\n- {duration_s: 1, move: {left.x_m_s: 0.1}}", "task.yaml:2: axis"),
        ("- {duration_s: 1, grip: object}\n- {duration_s: 1, mode: joint}", "task.yaml:2: mode joint"),
    ],
)
def test_each_step_of_a_script_is_checked_with_its_present_grip(tmp_path: Path, text: str, told: str) -> None:
    file = tmp_path / "task.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ControllerError, match=told):
        Script.load(file, Teleoperator(model("dawm"), CYCLE_S, DrivingMode.COUPLED))


# --- the object ---------------------------------------------------------------------------------------------------


def test_rigid_motion_of_the_hands_has_no_relative_error(
    dawm: RobotModel, random: np.random.Generator
) -> None:
    rotations, positions = poses(dawm, dawm.home)
    taken = HeldObject(rotations, positions)
    for _ in range(20):
        turn, shift = pin.exp3(random.uniform(-1.5, 1.5, 3)), random.uniform(-1.0, 1.0, 3)
        moved = turn @ rotations, positions @ turn.T + shift
        assert max(taken.parted(*moved)) < 1e-9
        assert taken.axes(moved[0]) == pytest.approx(turn, abs=1e-9)
        for found, expected in zip(taken.placed(*moved), moved, strict=True):
            assert found == pytest.approx(expected, abs=1e-9)


def test_separated_hands_report_their_error_and_are_brought_together(
    dawm: RobotModel, random: np.random.Generator
) -> None:
    rotations, positions = poses(dawm, dawm.home)
    taken = HeldObject(rotations, positions)
    off = positions + np.array([[0.0, 0.0, 0.0], [0.003, 0.0, 0.0]])
    assert taken.parted(rotations, off)[0] == pytest.approx(0.003)
    turned = np.array([rotations[0], pin.exp3(np.array([0.0, 0.02, 0.0])) @ rotations[1]])
    assert taken.parted(turned, positions)[1] == pytest.approx(0.02)
    assert max(taken.parted(*taken.placed(turned, off))) < 1e-9


def test_twists_of_the_hands_are_the_derivative_of_their_poses_on_the_object(
    dawm: RobotModel, random: np.random.Generator
) -> None:
    rotations, positions = poses(dawm, dawm.home)
    twist, step = random.uniform(-1.0, 1.0, 6), 1e-6
    middle = positions.mean(axis=0)
    moved = (positions - middle) @ pin.exp3(step * twist[3:]).T + middle + step * twist[:3]
    found = HeldObject(rotations, positions).hands_twists(positions, twist)
    assert found[:, :3] == pytest.approx((moved - positions) / step, abs=1e-5)
    assert found[:, 3:] == pytest.approx(np.tile(twist[3:], (2, 1)))


# --- the drive ----------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("mode", HANDS_MODES)
def test_hands_on_an_object_keep_their_relative_pose_at_bounds_that_separate_free_hands(
    dawm: RobotModel, mode: DrivingMode
) -> None:
    parted = drive(dawm, mode, OBJECT, CYCLE_S, seed=101, directions=3)
    assert parted[:, 0].max() < KEPT_M
    assert parted[:, 1].max() < KEPT_RAD
    assert drive(dawm, mode, FREE, CYCLE_S, seed=101, directions=1)[:, 0].max() > 0.05


@pytest.mark.long
def test_a_brake_of_the_gate_separates_the_hands_little_and_they_come_together_again(
    dawm: RobotModel,
) -> None:
    parted = drive(dawm, DrivingMode.COUPLED, OBJECT, CYCLE_S, seed=102, lost_share=LOST_SHARE, directions=4)
    assert 1e-5 < parted[:, 0].max() < BRAKED_M
    assert parted[:, 1].max() < BRAKED_RAD
    assert np.median(parted[:, 0]) < KEPT_M


@pytest.mark.long
def test_an_object_turns_about_its_middle_and_moves_along_its_own_axes(dawm: RobotModel) -> None:
    run = held(frame=Frame.TOOL)
    start = poses(dawm, run.now)[1].mean(axis=0)
    run.drive(1.0, rz=0.5)
    run.rest()
    rotations, positions = poses(dawm, run.now)
    assert positions.mean(axis=0) == pytest.approx(start, abs=1e-5)
    taken = run.teleoperator.held
    assert taken is not None
    ahead = taken.axes(rotations)[:, 0]
    assert np.arctan2(ahead[1], ahead[0]) > 0.4
    run.drive(1.0, x=0.1)
    moved = poses(dawm, run.now)[1].mean(axis=0) - positions.mean(axis=0)
    assert moved / np.linalg.norm(moved) == pytest.approx(ahead, abs=1e-4)
    assert run.violations == 0


def test_a_common_base_joint_carries_the_object_and_a_joint_of_one_arm_does_not(
    dawm: RobotModel,
) -> None:
    run = held(DrivingMode.DECOUPLED)
    start = poses(dawm, run.now)[1].mean(axis=0)
    run.drive(0.6, left_yaw=0.2)
    run.rest()
    assert poses(dawm, run.now)[1].mean(axis=0) == pytest.approx(start, abs=1e-5)
    assert run.now[dawm.joint_names.index("left_yaw")] - dawm.home[dawm.joint_names.index("left_yaw")] > 0.05
    run.drive(0.6, torso=0.2)
    assert np.linalg.norm(poses(dawm, run.now)[1].mean(axis=0) - start) > 0.01
    taken = run.teleoperator.held
    assert taken is not None
    assert max(taken.parted(*poses(dawm, run.now))) < KEPT_M


def test_an_object_is_taken_and_released_at_rest_and_marked_in_the_record(dawm: RobotModel) -> None:
    run = PlainDrive("dawm", DrivingMode.COUPLED)
    teleoperator = run.teleoperator
    log = DriveLog(teleoperator, CYCLE_S)
    for _ in range(40):
        run.step(OperatorCommand({"left.x": 0.1}))
        log.add(run.now)
    run.step(OperatorCommand({"x": 0.1}, grip=OBJECT))
    assert teleoperator.grip is FREE, "the hands still move"
    for _ in range(100):
        stood = not run.dq_last.any()
        run.step(OperatorCommand({"x": 0.1}))
        if teleoperator.grip is OBJECT:
            break
    assert stood, "it is taken at rest"
    for _ in range(40):
        run.step(OperatorCommand({"rz": 0.3}))
        log.add(run.now)
    free, kept = log.summary()
    assert (free["grip"], free["object"]) == ("free", None)
    assert kept["grip"] == "object"
    assert kept["object"]["parted_mm"] < 1000 * KEPT_M
    assert kept["object"]["twisted_deg"] < np.rad2deg(KEPT_RAD)


@pytest.mark.long
def test_the_limit_of_a_held_object_is_reported_as_such() -> None:
    run = held(DrivingMode.DECOUPLED)
    run.drive(3.5, rx=0.3)
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert limitation.text.startswith("the object, held by all hands: ")


def test_a_key_cycles_through_hands_and_object_and_omits_the_mode_that_would_separate_them() -> None:
    run = PlainDrive("dawm", DrivingMode.COUPLED)
    terminal = Terminal(run.teleoperator)
    with terminal.keyboard:
        assert terminal.press("w", 1.0) == OperatorCommand({"x": pytest.approx(0.1 / 7)}, grip=FREE)
        command = terminal.press("hhh", 1.1)
        assert command == OperatorCommand(grip=OBJECT), "and the hands stop"
        run.step(command)
        assert "hand object" in terminal.keyboard.status
        assert terminal.press("w", 1.2) == OperatorCommand({"x": pytest.approx(0.1 / 7)}, grip=OBJECT)
        modes = [terminal.press("m", 2.0) for _ in range(3)]
        assert DrivingMode.JOINT not in {command.mode for command in modes if command is not None}
    terminal.close()
