"""A camera whose view changes while it follows: distance, target, and the robot that is watched."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Body, Pose
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Sight, ViewTarget, ViewWish
from deltaq_protocol.messages.motion import AIM_M, TargetPoint

AIDE_HOME = np.deg2rad([60.0, -80.0, 90.0, 0.0, 30.0, 0.0])


@cache
def three() -> CellModel:
    """The lab with a third robot, `aide`, on the floor beside the follower; it carries a camera too."""
    fr = lab().robots["fr"]
    moved = fr.description.model_copy(update={"base": Pose(position_m=(1.6, -0.6, 0.0), rpy_deg=(0, 0, 90))})
    aide = RobotModel(moved, "aide", fr.urdf)
    robots = {**lab().robots, "aide": aide}
    description = lab().description.model_copy(update={"robots": {**lab().description.robots, "aide": moved}})
    return CellModel.of(description, robots)


class Curtain(Outlook):
    """What hides targets from the follower in a cell, and for as long as the curtain is open, in one without it."""

    def __init__(self, drawn: CellModel) -> None:
        super().__init__(drawn, "fr")
        self.open, self._open = False, Outlook(three(), "fr")

    def hidden_by(self, view: View, target: ViewTarget) -> tuple[str, ...]:
        return self._open.hidden_by(view, target) if self.open else super().hidden_by(view, target)


class Loop:
    """The follower among robots that stand, in plain kinematics."""

    def __init__(self, name: str, cell: CellModel | None = None) -> None:
        cell = cell or three()
        scenes = {leader: Scene(cell, "fr", leader) for leader in ("gr", "aide")}
        cameras = {leader: camera_controller_named(name, scene, 1.25) for leader, scene in scenes.items()}
        self.curtain = Curtain(cell)
        self.camera = CameraInUse(cameras, "gr", self.curtain)
        self.robot, self.q, self.dq = cell.robots["fr"], np.array(cell.robots["fr"].home), np.zeros(6)
        self.others = {"gr": np.array(cell.robots["gr"].home), "aide": AIDE_HOME}
        self.silent: set[str] = set()
        self.cycle = self.violations = 0

    def run(self, time_s: float, wish: ViewWish | None = None) -> Loop:
        for _ in range(round(time_s / CYCLE_S)):
            heard = {name: q for name, q in self.others.items() if name not in self.silent}
            others = {name: self._seen(q) for name, q in heard.items()}
            self.camera.take(wish)
            dq = self.camera.increment(View(self._seen(self.q), others))
            self.violations += limit_violations(self.robot, self.q, dq, self.dq)
            self.q, self.dq = self.q + dq, dq
            self.cycle += 1
        return self

    def looks_at(self, target: Array) -> tuple[float, float]:
        """How far the view is off a point [deg], and its distance [m]."""
        T = self.robot.camera_pose(self.q)
        way = target - T[:3, 3]
        distance = float(np.linalg.norm(way))
        return float(np.rad2deg(np.arccos(np.clip(T[:3, 2] @ way / distance, -1.0, 1.0)))), distance

    def tool(self, leader: str, offset_m: TargetPoint = AIM_M) -> Array:
        return Scene(three(), "fr", leader, offset_m).focus_at(self.others[leader])

    def _seen(self, q: Array) -> RobotView:
        return RobotView(self.cycle, self.cycle * CYCLE_S, q, q)


@pytest.mark.parametrize("name", ["paper", "qp"])
def test_distance_and_target_change_while_it_follows(name: str) -> None:
    loop = Loop(name).run(0.3)
    offset = (0.0, 0.0, 0.1)
    angle_deg, distance_m = loop.run(2.5, ViewWish(distance_m=1.0, aim_offset_m=offset)).looks_at(
        loop.tool("gr", offset)
    )
    assert angle_deg < 0.5
    assert distance_m == pytest.approx(1.0, abs=0.01)
    point = loop.tool("gr") + 0.1
    angle_deg, distance_m = loop.run(2.5, ViewWish(distance_m=1.1, focus_m=tuple(point))).looks_at(point)
    assert angle_deg < 0.5
    assert distance_m == pytest.approx(1.1, abs=0.01)
    assert loop.violations == 0


@pytest.mark.parametrize("name", ["paper", "qp"])
def test_another_leader_is_watched_without_a_jump(name: str) -> None:
    loop = Loop(name).run(0.2, ViewWish(distance_m=1.0))
    assert np.abs(loop.dq).max() > 0.0, "it moves when it is told"
    loop.run(2.5, ViewWish(distance_m=1.0, leader="aide"))
    assert loop.camera.leader == "aide"
    assert loop.looks_at(loop.tool("aide"))[0] < 1.0
    assert loop.looks_at(loop.tool("gr"))[0] > 20.0
    assert loop.violations == 0


def test_a_requested_view_is_applied_once() -> None:
    loop = Loop("qp")
    wish = ViewWish(distance_m=1.0)
    loop.camera.take(wish)
    loop.camera.desired_distance_m = 1.3
    loop.camera.take(wish)
    assert loop.camera.desired_distance_m == 1.3
    loop.camera.take(None)
    assert loop.camera.desired_distance_m == 1.3


def test_a_requested_distance_keeps_the_initial_target_point() -> None:
    point = np.array([0.0, -0.8, 1.2])
    camera = camera_controller_named("qp", Scene(lab(), "fr", "gr"), 1.25, point)
    in_use = CameraInUse({"gr": camera}, "gr", Outlook(lab(), "fr"))
    q_leader = lab().robots["gr"].home
    before = in_use.errors(lab().robots["fr"].home, q_leader)[0]
    in_use.take(ViewWish(distance_m=1.0))
    assert in_use.errors(lab().robots["fr"].home, q_leader)[0] == before
    in_use.take(ViewWish(leader="gr"))
    assert in_use.errors(lab().robots["fr"].home, q_leader)[0] != before


def curtained(size_m: tuple[float, float, float] = (3.0, 0.1, 2.0)) -> CellModel:
    """The three with a curtain half way between the follower's lens and the leader's tool, all at home."""
    cell = three()
    lens = cell.robots["fr"].camera_pose(cell.robots["fr"].home)[:3, 3]
    centre = 0.5 * (lens + Scene(cell, "fr", "gr").focus_at(cell.robots["gr"].home))
    curtain = Body.model_validate(
        {"shape": {"kind": "box", "size_m": size_m}, "pose": {"position_m": centre.tolist()}}
    )
    structure = {**cell.description.structure, "curtain": curtain}
    return CellModel.of(cell.description.model_copy(update={"structure": structure}), cell.robots)


BEFORE_ITS_LENSES_M = (0.0, 0.0, 0.1)
GR, AIDE = ViewTarget(leader="gr"), ViewTarget(leader="aide", aim_offset_m=BEFORE_ITS_LENSES_M)
BOTH = ViewWish(distance_m=1.25, targets=(GR, AIDE))


@pytest.mark.by_day(1)
@pytest.mark.parametrize("name", ["paper", "qp"])
def test_a_hidden_target_is_replaced_by_the_next_and_resumed_without_a_jump(name: str) -> None:
    loop = Loop(name, curtained()).run(0.4, BOTH)
    assert loop.camera.target == GR, "an arm that passes by is waited for"
    loop.run(3.5, BOTH)
    assert loop.camera.target == AIDE
    assert loop.looks_at(loop.tool("aide", BEFORE_ITS_LENSES_M))[0] < 1.0
    loop.curtain.open = True
    loop.run(3.5, BOTH)
    assert loop.camera.target == GR
    assert loop.camera.sight is Sight.FRESH
    assert loop.looks_at(loop.tool("gr"))[0] < 1.0
    assert loop.violations == 0


@pytest.mark.by_day(1)
@pytest.mark.parametrize("name", ["paper", "qp"])
def test_a_target_visible_only_from_elsewhere_is_tried_ever_more_rarely(
    name: str,
) -> None:
    loop, turned, before = Loop(name, curtained((0.5, 0.5, 0.3))), [], GR
    for _ in range(600):
        if (now := loop.run(0.1, BOTH).camera.target) != before:
            turned.append(loop.cycle * CYCLE_S)
            before = now
    to_gr = np.diff(turned[1::2])
    assert len(to_gr) >= 3, "the camera sees the leader from where it watches the aide"
    assert (np.diff(to_gr) > 0.5).all()
    assert loop.violations == 0


def test_a_single_hidden_target_is_kept_and_reported_with_the_hiding_body() -> None:
    loop = Loop("qp", curtained()).run(0.1)
    assert loop.camera.sight is Sight.FRESH
    loop.run(0.6)
    assert loop.camera.sight is Sight.HIDDEN
    assert loop.camera.hidden_by == ("structure/curtain",)
    assert loop.camera.target.leader == "gr"


def test_a_robot_without_a_state_is_no_target() -> None:
    loop = Loop("qp")
    loop.silent.add("aide")
    loop.run(1.5, ViewWish(targets=(AIDE, GR)))
    assert loop.camera.target == GR
    loop.silent.clear()
    loop.run(1.5, ViewWish(targets=(AIDE, GR)))
    assert loop.camera.target == AIDE


def test_another_distance_does_not_change_the_target() -> None:
    loop = Loop("qp", curtained()).run(2.0, BOTH)
    assert loop.camera.target == AIDE
    loop.run(0.1, BOTH.model_copy(update={"distance_m": 1.0}))
    assert loop.camera.target == AIDE
    assert loop.camera.desired_distance_m == 1.0


def test_after_several_targets_a_leader_is_watched_at_the_initial_point() -> None:
    offset_m = (0.0, 0.0, 0.08)
    camera = camera_controller_named("qp", Scene(lab(), "fr", "gr", offset_m), 1.25)
    in_use = CameraInUse({"gr": camera}, "gr", Outlook(lab(), "fr"))
    in_use.take(ViewWish(targets=(ViewTarget(focus_m=(0.0, -0.8, 1.2)), GR)))
    assert in_use.target == ViewTarget(focus_m=(0.0, -0.8, 1.2))
    in_use.take(ViewWish(leader="gr"))
    assert in_use.target == ViewTarget(leader="gr", aim_offset_m=offset_m)


@pytest.mark.parametrize("name", ["qp", "predictive"])
def test_a_camera_that_cannot_come_as_far_as_asked_names_its_bounds_and_keeps_looking(name: str) -> None:
    loop = Loop(name).run(3.0)
    assert (loop.camera.sight, loop.camera.held_back_by) == (Sight.FRESH, ())
    loop.run(8.0, ViewWish(distance_m=3.5))
    angle_deg, distance_m = loop.looks_at(loop.tool("gr"))
    assert loop.camera.sight is Sight.OUT_OF_REACH
    assert loop.camera.held_back_by
    assert angle_deg < 0.5
    assert 1.5 < distance_m < 3.4
    loop.run(8.0, ViewWish(distance_m=1.25))
    assert (loop.camera.sight, loop.camera.held_back_by) == (Sight.FRESH, ())
    assert loop.looks_at(loop.tool("gr"))[1] == pytest.approx(1.25, abs=0.01)
    assert loop.violations == 0
