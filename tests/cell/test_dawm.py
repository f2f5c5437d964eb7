"""The dual-arm robot: a tree of two chains with two hands, and the cell it stands in."""

from itertools import combinations
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import make_dawm_urdf
from deltaq_cell.cell_model import CellModel
from deltaq_cell.check import check_cell
from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell, parse_cell
from deltaq_cell.models import RobotModelError
from deltaq_cell.problems import CellError
from deltaq_cell.robot import RobotModel

CELL = CellModel.load("dawm")
DAWM = CELL.robots["dawm"]
SIDES = {"left": range(1, 9), "right": range(9, 17)}


def test_the_model_has_its_published_figures_and_marks_assumed_ones() -> None:
    assert make_dawm_urdf.FILE.read_text(encoding="utf-8") == make_dawm_urdf.text()
    assert "ALL LENGTHS, LIMITS, SPEEDS, SHAPES AND MASSES ARE STAND-INS" in make_dawm_urdf.text()
    assert "stand-ins" in CELL.yaml


def test_it_has_17_joints_in_a_tree_of_two_chains_that_share_the_torso() -> None:
    assert DAWM.n == 17
    assert DAWM.hands == ("left", "right")
    for hand, joints in SIDES.items():
        J = DAWM.jacobian(DAWM.home, hand)
        moved_by = set(np.flatnonzero(np.abs(J).max(axis=0) > 1e-9).tolist())
        assert moved_by == {0, *joints}


@pytest.mark.parametrize("hand", ["left", "right"])
def test_a_hand_reaches_as_far_as_its_links_are_long(hand: str) -> None:
    T = DAWM.forward(np.zeros(17), hand)
    reach = 0.45 + 0.25 + 0.12 + 0.84 + 0.48 + 0.17 + 0.31
    np.testing.assert_allclose(T[:3, 3], [reach, 0.35 if hand == "left" else -0.35, 1.2], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("joint", ["pitch", "2", "3", "4"])
@pytest.mark.parametrize("hand", ["left", "right"])
def test_positive_joints_lift(hand: str, joint: str) -> None:
    q = np.zeros(17)
    q[DAWM.joint_names.index(f"{hand}_{joint}")] = 0.1
    assert DAWM.forward(q, hand)[2, 3] > 1.2


@pytest.mark.parametrize("hand", ["left", "right"])
def test_the_jacobian_of_a_hand_agrees_with_finite_differences(hand: str) -> None:
    step = 1e-6
    for q in np.random.default_rng(1).uniform(DAWM.lower, DAWM.upper, (5, 17)):
        J = DAWM.jacobian(q, hand)
        for joint in range(17):
            Ta, Tb = (DAWM.forward(q + sign * step * np.eye(17)[joint], hand) for sign in (1, -1))
            angular = pin.log3(Ta[:3, :3] @ Tb[:3, :3].T)
            numeric = np.concatenate([Ta[:3, 3] - Tb[:3, 3], angular]) / (2 * step)
            np.testing.assert_allclose(J[:, joint], numeric, atol=1e-7)


def test_the_single_tool_pose_is_that_of_the_first_hand() -> None:
    np.testing.assert_array_equal(DAWM.forward(DAWM.home), DAWM.forward(DAWM.home, "left"))
    assert DAWM.tool_pose(DAWM.home).position == tuple(DAWM.forward(DAWM.home, "left")[:3, 3].tolist())


def test_an_unknown_hand_is_answered_with_the_known_hands() -> None:
    with pytest.raises(RobotModelError, match=r"one of left, right, tool, got 'lefd'; did you mean 'left'\?"):
        DAWM.forward(DAWM.home, "lefd")


def test_the_fingers_move_with_their_hand() -> None:
    bodies = {body.name: body for body in DAWM.geometry.geometryObjects}
    for hand in SIDES:
        finger = bodies[f"dawm/{hand}_finger_1"]
        assert DAWM.model.names[finger.parentJoint] == f"{hand}_6"


def test_the_cell_is_good_and_its_robot_keeps_its_own_time() -> None:
    assert check_cell("dawm").problems == ()
    assert CELL.description.robots["dawm"].driver.kind == "kinematic"


def test_at_home_all_bodies_are_clear_with_space_to_move() -> None:
    data = DAWM.model.createData()
    pin.forwardKinematics(DAWM.model, data, np.array(DAWM.home))
    placed = [(body.name, body.geometry, body.placement) for body in CELL.structure]
    placed += [
        (body.name, body.geometry, data.oMi[body.parentJoint] * body.placement)
        for body in DAWM.geometry.geometryObjects
    ]
    never = DAWM.never_checked_pairs()
    for (a, shape_a, pose_a), (b, shape_b, pose_b) in combinations(placed, 2):
        if {a.split("/")[0], b.split("/")[0]} == {"structure"} or tuple(sorted((a, b))) in never:
            continue
        places = [coal.Transform3s(pose.rotation, pose.translation) for pose in (pose_a, pose_b)]
        distance = coal.distance(
            shape_a, places[0], shape_b, places[1], coal.DistanceRequest(), coal.DistanceResult()
        )
        own = a.startswith("dawm") and b.startswith("dawm")
        assert distance > (0.04 if own else 0.15), f"{a} {b} {distance}"


def write(folder: Path, old: str, new: str) -> Path:
    text = find_cell("dawm").read_text(encoding="utf-8")
    assert old in text
    path = folder / "mine.yaml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def test_a_hand_on_an_unknown_link_is_reported_with_its_line(tmp_path: Path) -> None:
    (problem,) = check_cell(write(tmp_path, "link: left_hand", "link: left_hnad")).errors
    assert problem.field == "robots.dawm.hands.left.link"
    assert problem.suggestion == "left_hand"


def test_a_robot_has_a_tool_or_hands_but_not_both(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="a robot with hands carries its tools there: leave out tool"):
        load_cell(write(tmp_path, "    hands:", "    tool: {}\n    hands:"))


@pytest.mark.parametrize("name", ["camera", "object"])
def test_a_hand_cannot_take_the_name_of_another_frame(tmp_path: Path, name: str) -> None:
    with pytest.raises(CellError, match=f"a hand cannot be named {name}; name it otherwise"):
        load_cell(write(tmp_path, "      left:\n", f"      {name}:\n"))


def test_a_tolerance_too_wide_for_the_longer_arm_is_reported(tmp_path: Path) -> None:
    wide = "max_acceleration_rad_s2: 1, tracking_tolerance_deg: 5}"
    path = write(tmp_path, "max_acceleration_rad_s2: 1, tracking_tolerance_deg: 0.001}", wide)
    (problem,) = check_cell(path).warnings
    # 0.05 m at 0.35 + 0.45 + 0.25 + 0.12 + 0.84 + 0.48 + 0.17 + 0.31 m
    assert problem.bound == pytest.approx(np.rad2deg(0.05 / 2.97), abs=1e-3)


def test_a_client_builds_the_robot_from_its_description() -> None:
    message = CELL.description_message()
    description = parse_cell(message.yaml, "what the client was told")
    robot = RobotModel(description.robots["dawm"], "dawm", urdf=message.urdf["dawm"])
    q = np.random.default_rng(2).uniform(DAWM.lower, DAWM.upper)
    for hand in SIDES:
        np.testing.assert_array_equal(robot.forward(q, hand), DAWM.forward(q, hand))
