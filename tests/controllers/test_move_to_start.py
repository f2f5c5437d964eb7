"""Going to a start, and turning the view distance by the states' own clock."""

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations

from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.camera_follower import MoveToStart
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.limits import IncrementLimits

ROBOT, Q_LEADER = lab().robots["fr"], lab().robots["gr"].home


def seen(cycle: int, q_cmd: np.ndarray, q: np.ndarray | None = None) -> View:
    time_s = 100.0 + cycle * CYCLE_S
    own = RobotView(cycle, time_s, q_cmd if q is None else q, q_cmd)
    return View(own, {"gr": RobotView(cycle, time_s, Q_LEADER, Q_LEADER)})


def test_the_robot_moves_to_its_start_rests_and_then_follows() -> None:
    camera = camera_controller_named("qp", Scene(lab(), "fr", "gr"), 1.25)
    start = ROBOT.home + np.array([0.3, -0.2, 0.1, 1.0, -0.4, 0.2])
    move_to_start = MoveToStart(camera, IncrementLimits.of(ROBOT, CYCLE_S), start)
    q, dq_last, q_began = np.array(ROBOT.home), np.zeros(6), None
    for cycle in range(round(6.0 / CYCLE_S)):
        dq = move_to_start.increment(seen(cycle, q))
        if move_to_start.began_s is not None and q_began is None:
            q_began = q
            assert move_to_start.began_s == pytest.approx(100.0 + cycle * CYCLE_S)
            assert np.abs(dq_last).max() < 1e-4
        assert limit_violations(ROBOT, q, dq, dq_last) == 0
        q, dq_last = q + dq, dq
    assert q_began is not None
    np.testing.assert_allclose(q_began, start, atol=1e-4)
    assert np.rad2deg(camera.errors(q, Q_LEADER)[0]) < 0.1


@pytest.mark.parametrize("behind", [1, 5, 12])
def test_a_lagging_robot_has_arrived_when_it_rests_at_the_start(behind: int) -> None:
    camera = camera_controller_named("qp", Scene(lab(), "fr", "gr"), 1.25)
    start = ROBOT.home + np.array([0.3, -0.2, 0.1, 1.0, -0.4, 0.2])
    move_to_start = MoveToStart(camera, IncrementLimits.of(ROBOT, CYCLE_S), start)
    setpoints = [np.array(ROBOT.home)]
    for cycle in range(round(6.0 / CYCLE_S)):
        q = setpoints[max(0, len(setpoints) - 1 - behind)]
        dq = move_to_start.increment(seen(cycle, setpoints[-1], q))
        if move_to_start.began_s is not None:
            break
        setpoints.append(setpoints[-1] + dq)
    assert move_to_start.began_s is not None
    np.testing.assert_allclose(q, start, atol=2e-4)


def test_the_distance_changes_by_the_stamps_and_the_last_one_stays() -> None:
    camera = camera_controller_named("paper", Scene(lab(), "fr", "gr"), 1.25)
    move_to_start = MoveToStart(
        camera, IncrementLimits.of(ROBOT, CYCLE_S), distances_m=(1.25, 1.0), hold_s=0.5
    )
    told = []
    for cycle in (0, 41, 42, 83, 84, 200):
        move_to_start.increment(seen(cycle, ROBOT.home))
        told.append(camera.desired_distance_m)
    assert told == [1.25, 1.25, 1.0, 1.0, 1.0, 1.0]


def test_a_start_of_another_length_is_refused() -> None:
    camera = camera_controller_named("paper", Scene(lab(), "fr", "gr"), 1.25)
    with pytest.raises(ControllerError, match="the robot has 6 joints, got 3 values"):
        MoveToStart(camera, IncrementLimits.of(ROBOT, CYCLE_S), np.zeros(3))
