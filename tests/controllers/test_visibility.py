"""What a camera sees: the pictures of its eyes, and what stands on their lines of sight."""

import numpy as np
import pytest
from closed_loop import lab

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Body, Camera
from deltaq_cell.robot import RobotModel, RobotModelError
from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.outlook import Visibility, VisibilityGauge
from deltaq_controllers.camera.scene import Scene
from deltaq_protocol.arrays import Array

HOME = {name: robot.home for name, robot in lab().robots.items()}


def at(up: float, right: float, ahead: float) -> Array:
    """(3,) a point of fr's camera at home in the world, by the picture's directions [m]."""
    T = lab().robots["fr"].camera_pose(HOME["fr"])
    seen: Array = T[:3, 3] + T[:3, :3] @ [up, right, ahead]
    return seen


def with_wall(name: str, size_m: tuple[float, float, float], centre: Array) -> CellModel:
    """The lab with a box more, its sides along the world's axes."""
    wall = Body.model_validate(
        {"shape": {"kind": "box", "size_m": size_m}, "pose": {"position_m": centre.tolist()}}
    )
    description = lab().description
    structure = {**description.structure, name: wall}
    return CellModel.of(description.model_copy(update={"structure": structure}), lab().robots)


def look(target: Array, cell: CellModel | None = None) -> Visibility:
    return VisibilityGauge(cell or lab(), "fr").look(HOME, target)


def test_the_finger_of_the_leader_hides_the_space_between_its_fingers() -> None:
    between = Scene(lab(), "fr", "gr", (0.0, 0.0, 0.0)).focus_at(HOME["gr"])
    before = Scene(lab(), "fr", "gr").focus_at(HOME["gr"])
    assert look(between).in_picture == (True, True)
    assert look(between).blocked_by == (("gr/tool_finger_1",), ("gr/tool_finger_1",))
    assert look(between).eyes_seeing == 0
    assert look(before) == Visibility((True, True), ((), ()))
    assert look(before).is_seen


def test_a_wall_hides_points_behind_it() -> None:
    target = at(0.0, 0.0, 1.0)
    assert look(target).is_seen
    hidden = look(target, with_wall("wall", (0.3, 0.3, 0.3), at(0.0, 0.0, 0.5)))
    assert hidden.blocked_by == (("structure/wall",), ("structure/wall",))


def test_a_post_near_one_lens_hides_the_target_from_that_eye_alone() -> None:
    target = at(0.0, 0.0, 1.0)
    seen = look(target, with_wall("post", (0.02, 0.02, 0.02), at(0.0, 0.06 * 0.8, 0.2)))
    assert seen.blocked_by == ((), ("structure/post",))
    assert seen.eyes_seeing == 1
    assert not seen.is_seen


def test_the_arm_of_the_robot_hides_points_behind_it() -> None:
    robot = lab().robots["fr"]
    shoulder = robot.joint_origins(HOME["fr"])[1]
    behind = shoulder + 0.6 * (shoulder - at(0.0, 0.0, 0.0))
    assert all(any(body.startswith("fr/") for body in line) for line in look(behind).blocked_by)


@pytest.mark.parametrize(
    ("up_deg", "right_deg", "is_inside"),
    [
        (0.0, 0.0, True),
        (22.0, 0.0, True),
        (-22.0, 0.0, True),
        (23.0, 0.0, False),
        (0.0, 29.0, True),
        (0.0, 33.0, False),
    ],
)
def test_a_picture_has_its_given_height_and_one_and_a_half_times_the_width(
    up_deg: float, right_deg: float, is_inside: bool
) -> None:
    seen = look(at(np.tan(np.deg2rad(up_deg)), np.tan(np.deg2rad(right_deg)), 1.0))
    assert all(seen.in_picture) == is_inside


def test_a_point_behind_the_camera_is_in_no_picture() -> None:
    assert look(at(0.0, 0.0, -1.0)).in_picture == (False, False)


def test_a_camera_without_a_baseline_has_one_eye() -> None:
    robot = lab().robots["fr"]
    single = robot.description.camera.model_copy(update={"baseline_m": 0.0})  # type: ignore[union-attr]
    one_eyed = RobotModel(robot.description.model_copy(update={"camera": single}), "fr", robot.urdf)
    cell = CellModel.of(lab().description, {"fr": one_eyed, "gr": lab().robots["gr"]})
    assert look(at(0.0, 0.0, 1.0), cell).in_picture == (True,)


def test_a_robot_without_a_camera_is_refused_as_an_observer() -> None:
    with pytest.raises(RobotModelError, match="carries no camera"):
        VisibilityGauge(lab(), "gr")


@pytest.mark.parametrize("field", ["aspect", "baseline_m"])
def test_a_camera_with_an_invalid_picture_is_refused(field: str) -> None:
    with pytest.raises(ValueError, match=field):
        Camera.model_validate({field: -1.0})


@pytest.mark.parametrize("name", ["paper", "predictive", "qp"])
def test_a_controller_looks_at_the_given_point_of_the_tool(name: str) -> None:
    scene = Scene(lab(), "fr", "gr", (0.05, 0.0, 0.1))
    told = camera_controller_named(name, scene, 1.25).errors(HOME["fr"], HOME["gr"])
    fixed = camera_controller_named(name, scene, 1.25, scene.focus_at(HOME["gr"])).errors(
        HOME["fr"], HOME["gr"]
    )
    plain = camera_controller_named(name, Scene(lab(), "fr", "gr"), 1.25).errors(HOME["fr"], HOME["gr"])
    assert told == pytest.approx(fixed)
    assert told[0] != pytest.approx(plain[0], abs=np.deg2rad(1.0))
