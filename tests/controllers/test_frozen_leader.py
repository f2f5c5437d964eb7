"""A leader whose states freeze for three seconds while it goes on, in a closed loop of plain kinematics."""

from dataclasses import dataclass

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations

from deltaq_controllers.camera.controllers import Seeing, camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.camera_follower import Sightings
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_protocol.arrays import Array

FREEZES_S, COMES_BACK_S, ENDS_S = 3.0, 6.0, 7.0
DELAY_CYCLES = 2


@dataclass
class Seen:
    """What came of it, one entry a cycle; a speed is that of the fastest joint of the follower."""

    angle_deg: Array
    speed: Array
    violations: int
    told: list[tuple[str, float]]

    def between(self, begin_s: float, end_s: float) -> slice:
        return slice(round(begin_s / CYCLE_S), round(end_s / CYCLE_S))


def follow(name: str, leader_speed_m_s: float) -> Seen:
    robot, leader_model = lab().robots["fr"], lab().robots["gr"]
    leader = ScriptedLeader(leader_model, CYCLE_S, leader_speed_m_s, 0)
    camera = camera_controller_named(name, Scene(lab(), "fr", "gr"), 1.25)
    assert isinstance(camera, Seeing)
    q, q_leader, dq = np.array(robot.home), np.array(leader_model.home), np.zeros(robot.n)
    known, sightings, violations = [], Sightings(), 0
    angles, speeds = [], []
    for cycle in range(round(ENDS_S / CYCLE_S)):
        time_s = cycle * CYCLE_S
        q_leader = q_leader + leader.increment(View(RobotView(cycle, time_s, q_leader, q_leader)))
        known.append(RobotView(cycle, time_s, q_leader, q_leader))
        frozen = FREEZES_S <= time_s < COMES_BACK_S
        newest = min(cycle, round(FREEZES_S / CYCLE_S)) if frozen else cycle
        view = View(RobotView(cycle, time_s, q, q), {"gr": known[max(newest - DELAY_CYCLES, 0)]})
        increment = camera.increment(view)
        sightings.add(camera.leader_seen.sight, camera.leader_seen.age_s, time_s)
        violations += limit_violations(robot, q, increment, dq)
        q, dq = q + increment, increment
        angles.append(np.rad2deg(camera.errors(q, q_leader)[0]))
        speeds.append(np.abs(dq).max() / CYCLE_S)
    told = [(change["sight"], change["time_s"]) for change in sightings.summary()["changes"]]
    return Seen(np.array(angles), np.array(speeds), violations, told)


@pytest.mark.long
@pytest.mark.parametrize("name", ["predictive", "qp"])
def test_a_frozen_leader_becomes_stale_and_lost_and_is_resumed_without_a_jump(
    name: str,
) -> None:
    seen = follow(name, 0.25)
    stale, lost, fresh = seen.told
    assert (stale[0], lost[0], fresh[0]) == ("view_stale", "view_lost", "fresh")
    # a view is stale .1 s later than its link explains, and lost a second later
    assert stale[1] - FREEZES_S == pytest.approx(0.1, abs=1.5 * CYCLE_S)
    assert lost[1] - FREEZES_S == pytest.approx(1.0, abs=2.5 * CYCLE_S)
    assert fresh[1] == pytest.approx(COMES_BACK_S, abs=CYCLE_S)
    # nobody sees it move any more: the camera comes to rest, and does not chase it where it is not
    assert seen.speed[seen.between(lost[1] + 0.5, COMES_BACK_S)].max() < 0.05
    assert seen.violations == 0
    # what the leader did meanwhile is made good at once, and nothing is overshot
    found = seen.angle_deg[seen.between(COMES_BACK_S, ENDS_S)]
    below = int(np.argmax(found < 0.5))
    assert found[0] > 1.0, "the leader went on"
    assert 0 < below < 0.5 / CYCLE_S
    assert np.diff(found[: below + 1]).max() < 0.0
    assert found[below:].max() < 0.6
