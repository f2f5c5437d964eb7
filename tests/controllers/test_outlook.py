"""What hides a target from a camera, and what is a part of the target."""

import numpy as np
from closed_loop import lab, with_camera
from test_visibility import HOME, at, with_wall

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import TargetPoint, ViewTarget


def at_home(cell: CellModel) -> View:
    seen = {name: RobotView(0, 0.0, robot.home, robot.home) for name, robot in cell.robots.items()}
    return View(seen.pop("fr"), seen)


def hidden_by(target: ViewTarget, cell: CellModel | None = None) -> tuple[str, ...]:
    cell = cell or lab()
    return Outlook(cell, "fr").hidden_by(at_home(cell), target)


def fixed(point: Array) -> ViewTarget:
    x, y, z = point.tolist()
    focus_m: TargetPoint = (x, y, z)
    return ViewTarget(focus_m=focus_m)


def test_a_finger_hides_the_space_between_the_fingers_and_a_board_the_space_before_them() -> None:
    assert hidden_by(ViewTarget(leader="gr", aim_offset_m=(0.0, 0.0, 0.0))) == ("gr/tool_finger_1",)
    assert hidden_by(ViewTarget(leader="gr")) == ()
    lens = lab().robots["fr"].camera_pose(lab().robots["fr"].home)[:3, 3]
    way = lab().robots["gr"].forward(lab().robots["gr"].home)[:3, 3] - lens
    assert hidden_by(ViewTarget(leader="gr"), with_wall("board", (0.2,) * 3, lens + 0.5 * way)) == (
        "structure/board",
    )


def test_the_same_finger_hides_a_fixed_point_behind_it() -> None:
    between = lab().robots["gr"].forward(lab().robots["gr"].home)[:3, 3]
    assert hidden_by(fixed(between)) == ("gr/tool_finger_1",)


def test_one_eye_that_sees_is_enough() -> None:
    target = fixed(at(0.0, 0.0, 1.0))
    assert hidden_by(target, with_wall("post", (0.02,) * 3, at(0.0, 0.06 * 0.8, 0.2))) == ()


def test_a_camera_with_one_eye_has_one_line_of_sight() -> None:
    camera = lab().robots["fr"].description.camera
    assert camera is not None
    one_eye = with_camera(camera.model_copy(update={"baseline_m": 0.0}))
    cell = CellModel.of(lab().description, {**lab().robots, "fr": one_eye})
    assert hidden_by(fixed(at(0.0, 0.0, 1.0)), cell) == ()
    walled = with_wall("post", (0.02,) * 3, at(0.0, 0.0, 0.2))
    cell = CellModel.of(walled.description, {**lab().robots, "fr": one_eye})
    assert hidden_by(fixed(at(0.0, 0.0, 1.0)), cell) == ("structure/post",)


def test_only_bodies_before_a_point_hide_it_and_not_a_body_around_it() -> None:
    tank = with_wall("tank", (0.2,) * 3, at(0.0, 0.0, 0.6))
    assert hidden_by(fixed(at(0.0, 0.0, 0.6)), tank) == ()
    assert hidden_by(fixed(at(0.0, 0.0, 0.9)), tank) == ("structure/tank",)


def test_the_cameras_own_housing_hides_nothing_since_it_turns_with_the_camera() -> None:
    beside, behind = fixed(at(0.0, 0.6, 0.05)), fixed(at(0.3, 0.0, -0.5))
    assert all(Outlook(lab(), "fr")._gauge.look(HOME, np.array(beside.focus_m)).blocked_by)
    assert hidden_by(beside) == ()
    assert not set(hidden_by(behind)) & {"fr/tool_camera", "fr/tool_mount", "fr/link_6"}


def test_a_robot_missing_in_the_view_stays_at_its_last_place() -> None:
    outlook, view = Outlook(lab(), "fr"), at_home(lab())
    between = fixed(lab().robots["gr"].forward(lab().robots["gr"].home)[:3, 3])
    assert outlook.hidden_by(View(view.own), between) == ("gr/tool_finger_1",)
    aside = np.array(lab().robots["gr"].home) + np.eye(lab().robots["gr"].n)[0]
    assert outlook.hidden_by(View(view.own, {"gr": RobotView(0, 0.0, aside, aside)}), between) == ()
    assert outlook.hidden_by(View(view.own), between) == ()
