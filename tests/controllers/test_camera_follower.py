from collections import deque

import numpy as np
import pytest
from closed_loop import CYCLE_S, approach, lab, limit_violations

from deltaq_cell.models import RobotModelError
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.controllers import CameraController
from deltaq_controllers.camera.error import view_angle
from deltaq_controllers.camera.follower import CameraFollower, FollowerGains
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.spheres import Spheres

FR, GR = lab().robots["fr"], lab().robots["gr"]
STARTS = np.random.default_rng(23).uniform(
    np.deg2rad([-150, -140, 40, -150, -100, -200]), np.deg2rad([150, -60, 130, 150, 100, 200]), (10, 6)
)
FOCUS = np.array([-0.4, -1.25, 1.2])


def behind(q: np.ndarray, distance_m: float) -> np.ndarray:
    pose = FR.camera_pose(q)
    return pose[:3, 3] - distance_m * pose[:3, 2]


@pytest.mark.by_day(4)
@pytest.mark.parametrize("q", STARTS)
def test_the_camera_turns_to_the_focus_monotonically_from_any_start(q: np.ndarray) -> None:
    follower = CameraFollower(FR, None, CYCLE_S, floor_m=None)
    run = approach(follower, q, FOCUS, 4.0)
    assert run.violations == 0
    assert run.angle_deg[round(1.5 / CYCLE_S)] < 1.0
    assert run.angle_deg[-1] < 0.01
    assert (run.angle_deg - np.minimum.accumulate(run.angle_deg)).max() < 1.0
    assert abs(run.distance_error_m[-1]) < 0.005


@pytest.mark.by_day(3)
@pytest.mark.long
@pytest.mark.parametrize(
    "degrees", [(0, -90, 90, 0, 0, 0), (10, -110, 100, 20, 40, 10), (0, -120, 120, 0, 0, 0)]
)
def test_a_start_with_the_focus_exactly_behind_the_camera_works(degrees: tuple[float, ...]) -> None:
    q = np.deg2rad(degrees)
    follower = CameraFollower(FR, None, CYCLE_S)
    run = approach(follower, q, behind(q, 1.2), 4.0)
    assert run.angle_deg[0] == pytest.approx(180.0, abs=1e-4)
    assert run.angle_deg[-1] < 0.5
    assert run.violations == 0


def test_a_focus_behind_the_camera_on_the_axis_of_a1_is_found_over_the_top() -> None:
    q = np.deg2rad([0.0, -90, 90, 0, 0, 0])
    base = FR.T_world_base[:3, 3]
    focus = np.array([base[0], base[1], FR.camera_pose(q)[2, 3]])
    run = approach(CameraFollower(FR, None, CYCLE_S, floor_m=None), q, focus, 4.0)
    assert run.angle_deg[0] == pytest.approx(180.0, abs=1e-4)
    assert run.angle_deg[-1] < 0.5


def at_rest(delay_cycles: int) -> float:
    """Largest view angle [deg] in the last second, with what is commanded moving the robot some cycles later."""
    follower = CameraFollower(FR, None, CYCLE_S, floor_m=None)
    controller = CameraController(follower, GR, 1.2, FOCUS)
    q_cmd, dq = np.array(FR.home) + np.deg2rad([2.0, 0, 0, 0, 3, 0]), np.zeros(6)
    moving = deque([q_cmd] * (delay_cycles + 1), maxlen=delay_cycles + 1)
    angles = []
    for cycle in range(500):
        dq = follower.increment(q_cmd, dq, FOCUS, None, 1.2, cycle * CYCLE_S)
        q_cmd = q_cmd + dq
        moving.append(q_cmd)
        angles.append(np.rad2deg(controller.errors(moving[0], GR.home)[0]))
    return float(max(angles[-83:]))


@pytest.mark.parametrize("delay_cycles", [1, 2, 3])
def test_at_rest_the_robot_rests_at_any_delay_of_actuation(delay_cycles: int) -> None:
    assert at_rest(delay_cycles) < 1e-3


def placed(robot: RobotModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of a robot's bounding spheres."""
    kinematics, spheres = Kinematics(robot, "tool"), Spheres.of(robot)
    kinematics.update(q)
    return spheres.placed(kinematics.placements()), spheres.radii


def least_clearance(q: np.ndarray, q_leader: np.ndarray) -> float:
    """Clearance of bounding spheres, counted pair by pair."""
    (a, radii_a), (b, radii_b) = placed(FR, q), placed(GR, q_leader)
    between = np.linalg.norm(a[:, None] - b[None], axis=2)
    return float((between - radii_a[:, None] - radii_b[None]).min())


@pytest.mark.long
@pytest.mark.parametrize("speed_m_s", [0.25, 0.75])
def test_the_camera_evades_an_approaching_leader_and_keeps_looking_at_it(speed_m_s: float) -> None:
    follower, gantry = CameraFollower(FR, GR, CYCLE_S), Kinematics(GR, "tool")
    q, dq, q_leader = np.array(FR.home), np.zeros(6), np.array(GR.home)
    focus = GR.forward(q_leader)[:3, 3]
    angles, clearances = [], []
    for cycle in range(500):
        if cycle > 80:
            gantry.update(q_leader)
            way = FR.camera_pose(q)[:3, 3] - gantry.position
            x, y, z = speed_m_s * CYCLE_S * way / np.linalg.norm(way)
            moved = q_leader + np.array([-x, -y, z, 0, 0, 0, 0, 0, 0])
            q_leader = np.clip(moved, GR.lower, GR.upper)
        increment = follower.increment(q, dq, focus, q_leader, 1.2, cycle * CYCLE_S)
        assert limit_violations(FR, q, increment, dq) == 0
        q, dq = q + increment, increment
        pose = FR.camera_pose(q)
        angles.append(np.rad2deg(view_angle(pose[:3, :3], pose[:3, 3], focus)))
        clearances.append(least_clearance(q, q_leader) if cycle % 5 == 0 else np.inf)
    assert 0.08 < min(clearances) < follower.gains.repulsion_range_m
    assert max(angles[80:]) < 0.1


def test_the_camera_task_is_suspended_near_bodies_and_resumed_farther_away() -> None:
    gains = FollowerGains(emergency_on_m=10.0, emergency_off_m=10.1, repulsion_range_m=0.3)
    follower = CameraFollower(FR, GR, CYCLE_S, gains)
    dq = follower.increment(np.array(FR.home), np.zeros(6), FOCUS, np.array(GR.home), 1.2, 0.0)
    np.testing.assert_allclose(dq, np.zeros(6), atol=1e-9)


def test_until_the_leaders_first_state_the_robot_is_brought_to_rest() -> None:
    follower = CameraFollower(FR, GR, CYCLE_S)
    controller = CameraController(follower, GR, 1.2)
    q, dq = np.array(FR.home), np.full(6, 0.004)
    before = q - dq
    controller.increment(View(RobotView(1, 0.0, before, before)))
    cycle = 2
    while np.abs(dq).max() > 1e-9 and cycle < 100:
        increment = controller.increment(View(RobotView(cycle, 0.0, q, q)))
        assert limit_violations(FR, q, increment, dq) == 0 or cycle == 2
        q, dq, cycle = q + increment, increment, cycle + 1
    assert cycle < 40


def test_a_robot_without_a_camera_cannot_follow() -> None:
    with pytest.raises(RobotModelError, match=r"'gr' carries no camera; add one under robots\.gr\.camera"):
        CameraFollower(GR, FR, CYCLE_S)
