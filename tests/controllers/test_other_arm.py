"""The followers on an arm that nobody tuned them for: seven axes, by URDF, the camera off the last axis."""

import numpy as np
import pytest
import seven_axes
from closed_loop import CYCLE_S, limit_violations

from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader


@pytest.mark.long
@pytest.mark.parametrize("name", ["paper", "predictive", "qp"])
def test_another_arm_turns_to_the_leader_and_follows_it(name: str) -> None:
    cell = seven_axes.cell()
    arm, leader_model = cell.robots["fr"], cell.robots["gr"]
    controller = camera_controller_named(name, Scene(cell, "fr", "gr"), 1.25)
    leader = ScriptedLeader(leader_model, CYCLE_S, 0.25, 0)
    q, q_leader, dq_last = np.array(arm.home), np.array(leader_model.home), np.zeros(arm.n)
    before, errors = q_leader, []
    for cycle in range(round(6.0 / CYCLE_S)):
        time_s = cycle * CYCLE_S
        if time_s > 2.5:
            seen = RobotView(cycle, time_s, q_leader, q_leader)
            before, q_leader = q_leader, q_leader + leader.increment(View(seen))
        others = {"gr": RobotView(cycle, time_s - CYCLE_S, before, before)}
        dq = controller.increment(View(RobotView(cycle, time_s, q, q), others))
        assert limit_violations(arm, q, dq, dq_last) == 0
        q, dq_last = q + dq, dq
        errors.append(controller.errors(q, q_leader))
    angle, distance = np.abs(np.array(errors)).T
    assert np.rad2deg(angle[0]) > 100.0
    settled = round(2.5 / CYCLE_S)
    assert np.rad2deg(angle[settled:].max()) < 1.0
    assert distance[settled:].max() < 0.02
