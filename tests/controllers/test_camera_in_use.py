"""A camera whose view changes while it follows: distance, target, and the robot that is watched."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Pose
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import ViewWish

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


class Loop:
    """The follower among robots that stand, in plain kinematics."""

    def __init__(self, name: str) -> None:
        cell = three()
        scenes = {leader: Scene(cell, "fr", leader) for leader in ("gr", "aide")}
        cameras = {leader: camera_controller_named(name, scene, 1.25) for leader, scene in scenes.items()}
        self.camera = CameraInUse(cameras, "gr")
        self.robot, self.q, self.dq = cell.robots["fr"], np.array(cell.robots["fr"].home), np.zeros(6)
        self.others = {"gr": np.array(cell.robots["gr"].home), "aide": AIDE_HOME}
        self.cycle = self.violations = 0

    def run(self, time_s: float, wish: ViewWish | None = None) -> Loop:
        for _ in range(round(time_s / CYCLE_S)):
            others = {name: self._seen(q) for name, q in self.others.items()}
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

    def tool(self, leader: str, offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
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


def test_a_wish_that_was_taken_is_not_taken_again() -> None:
    loop = Loop("qp")
    wish = ViewWish(distance_m=1.0)
    loop.camera.take(wish)
    loop.camera.desired_distance_m = 1.3
    loop.camera.take(wish)
    assert loop.camera.desired_distance_m == 1.3
    loop.camera.take(None)
    assert loop.camera.desired_distance_m == 1.3


def test_a_wish_for_a_distance_leaves_a_point_that_it_was_started_with() -> None:
    point = np.array([0.0, -0.8, 1.2])
    camera = camera_controller_named("qp", Scene(lab(), "fr", "gr"), 1.25, point)
    in_use = CameraInUse({"gr": camera}, "gr")
    q_leader = lab().robots["gr"].home
    before = in_use.errors(lab().robots["fr"].home, q_leader)[0]
    in_use.take(ViewWish(distance_m=1.0))
    assert in_use.errors(lab().robots["fr"].home, q_leader)[0] == before
    in_use.take(ViewWish(leader="gr"))
    assert in_use.errors(lab().robots["fr"].home, q_leader)[0] != before
