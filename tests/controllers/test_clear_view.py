"""The follower that moves its lens aside until nothing hides the target."""

from __future__ import annotations

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations
from test_visibility import at, with_wall

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.clear_view import Side, SightGains
from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.outlook import VisibilityGauge
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages.motion import AIM_M, TargetPoint


class Standing:
    """A follower in plain kinematics whose leader stands at home."""

    def __init__(
        self, name: str, cell: CellModel, focus: Array | None = None, offset_m: TargetPoint = AIM_M
    ) -> None:
        self.cell, self.q_leader = cell, np.array(cell.robots["gr"].home)
        scene = Scene(cell, "fr", "gr", offset_m)
        self.focus = scene.focus_at(self.q_leader) if focus is None else focus
        self.camera = camera_controller_named(name, scene, 1.25, focus)
        self.q, self.dq = np.array(cell.robots["fr"].home), np.zeros(6)
        self.gauge = VisibilityGauge(cell, "fr")
        self.cycle = self.violations = 0

    def run(self, time_s: float) -> Standing:
        for _ in range(round(time_s / CYCLE_S)):
            own, leader = (RobotView(self.cycle, self.cycle * CYCLE_S, q, q) for q in (self.q, self.q_leader))
            dq = self.camera.increment(View(own, {"gr": leader}))
            self.violations += limit_violations(self.cell.robots["fr"], self.q, dq, self.dq)
            self.q, self.dq = self.q + dq, dq
            self.cycle += 1
        return self

    @property
    def eyes_seeing(self) -> int:
        return self.gauge.look({"fr": self.q, "gr": self.q_leader}, self.focus).eyes_seeing


def test_the_lens_moves_until_both_eyes_see_between_the_fingers_at_constant_angle_and_distance() -> None:
    qp, clear = (Standing(name, lab(), offset_m=(0.0, 0.0, 0.0)).run(4.0) for name in ("qp", "clear-view"))
    assert qp.eyes_seeing == 0
    assert clear.eyes_seeing == 2
    angle, distance = clear.camera.errors(clear.q, clear.q_leader)
    assert np.rad2deg(angle) < 0.1
    assert abs(distance) < 0.005
    assert clear.violations == 0


@pytest.mark.by_day(2)
@pytest.mark.parametrize("aside_m", [-0.1, -0.03, 0.03, 0.1])
def test_the_lens_moves_round_a_post_to_either_side(aside_m: float) -> None:
    focus = at(0.0, 0.0, 1.25)
    post = with_wall("post", (0.25, 0.25, 0.25), at(0.0, aside_m, 0.9))
    hidden = Standing("qp", post, focus)
    assert hidden.eyes_seeing == 0
    assert hidden.run(4.0).eyes_seeing == 0
    clear = Standing("clear-view", post, focus).run(4.0)
    assert clear.eyes_seeing == 2
    assert clear.violations == 0


def test_where_nothing_is_near_the_line_of_sight_its_increments_are_those_of_qp() -> None:
    qp, clear = (Standing(name, lab(), at(0.3, 0.0, 1.0)) for name in ("qp", "clear-view"))
    for _ in range(100):
        assert (qp.run(CYCLE_S).q == clear.run(CYCLE_S).q).all()


def test_the_side_of_passing_is_kept_beyond_the_middle_of_a_body_and_changed_at_a_limit() -> None:
    side, x = Side(SightGains()), np.array([1.0, 0.0, 0.0])
    stalled_s = SightGains().stalled_s
    fast, still = 0.1 * CYCLE_S * x, np.zeros(3)
    assert (side.chosen(x, fast, CYCLE_S) == x).all()
    assert (side.chosen(-x, fast, CYCLE_S) == x).all(), "past the middle the way out is still ahead"
    chosen = [side.chosen(x, still, CYCLE_S) for _ in range(round(stalled_s / CYCLE_S) + 2)]
    assert (chosen[-1] == -x).all()
    assert all((one == x).all() for one in chosen[: round(stalled_s / CYCLE_S) - 1])
    side.clear()
    assert (side.chosen(x, still, CYCLE_S) == x).all()
