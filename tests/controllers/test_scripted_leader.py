import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.leader.attacking import AttackingLeader
from deltaq_controllers.leader.scripted import Joystick, ScriptedLeader, Workspace
from deltaq_testing.oracle import ClearanceOracle

GR = lab().robots["gr"]


def lead(leader: ScriptedLeader, duration_s: float, robot: RobotModel = GR) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and tool positions, one a cycle; every increment is held to the robot's limits."""
    kinematics = Kinematics(robot, "tool")
    q, dq = np.array(robot.home), np.zeros(robot.n)
    configurations, positions = [], []
    for cycle in range(round(duration_s / CYCLE_S)):
        increment = leader.increment(View(RobotView(cycle, cycle * CYCLE_S, q, q)))
        assert limit_violations(robot, q, increment, dq) == 0
        q, dq = q + increment, increment
        kinematics.update(q)
        configurations.append(q)
        positions.append(kinematics.position)
    return np.array(configurations), np.array(positions)


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_the_tool_moves_mostly_at_the_given_speed_and_never_faster(seed: int) -> None:
    leader = ScriptedLeader(GR, CYCLE_S, 0.25, seed)
    _, positions = lead(leader, 45.0)
    velocity = np.diff(positions, axis=0) / CYCLE_S
    speed = np.linalg.norm(velocity, axis=1)
    assert speed.max() < 0.2505
    assert np.mean(speed > 0.24) > 0.8
    acceleration = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / CYCLE_S
    assert acceleration.max() < 2.1
    low, high = np.array(leader.workspace.low), np.array(leader.workspace.high)
    assert (positions > low - 0.01).all()
    assert (positions < high + 0.01).all()
    # it gets about: most of the box is visited
    assert (np.ptp(positions, axis=0) > 0.6 * (high - low)).all()


@pytest.mark.long
def test_gantry_and_arm_share_the_motion() -> None:
    configurations, _ = lead(ScriptedLeader(GR, CYCLE_S, 0.25, 0), 20.0)
    travel = np.ptp(configurations, axis=0)
    assert (travel[:3] > 0.1).all()
    assert (travel[3:] > np.deg2rad(1.0)).sum() >= 3


def test_one_seed_is_one_motion() -> None:
    first, second, other = (lead(ScriptedLeader(GR, CYCLE_S, 0.25, seed), 4.0)[0] for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0])
def test_a_fast_leader_keeps_its_limits_too(speed_m_s: float) -> None:
    _, positions = lead(ScriptedLeader(GR, CYCLE_S, speed_m_s, 0), 10.0)
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / CYCLE_S
    assert 0.8 * speed_m_s < speed.max() < 1.01 * speed_m_s


@pytest.mark.long
def test_a_faster_stick_acceleration_is_followed_within_joint_limits() -> None:
    means, accelerations = [], []
    for stick_m_s2 in (2.0, 8.0):
        leader = ScriptedLeader(GR, CYCLE_S, 0.5, 0, stick_m_s2=stick_m_s2)
        velocity = np.diff(lead(leader, 15.0)[1], axis=0) / CYCLE_S
        means.append(np.linalg.norm(velocity, axis=1).mean())
        accelerations.append(np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() / CYCLE_S)
    assert accelerations[0] < 2.1
    assert accelerations[1] > 3.5
    assert means[1] > 1.03 * means[0]


@pytest.mark.nightly
def test_around_its_home_in_the_lab_the_leader_stays_clear_of_everything() -> None:
    cell, oracle = lab(), ClearanceOracle(lab())
    stop, self_stop = cell.description.gate.stop_distance_m, cell.description.gate.self_stop_distance_m
    for seed in (0, 1, 2):
        configurations, _ = lead(ScriptedLeader(GR, CYCLE_S, 0.25, seed), 45.0)
        for q in configurations[::50]:
            both = {"fr": cell.robots["fr"].home, "gr": q}
            assert oracle.between_robots_and_structure(both).distance_m > stop + 0.02
            assert oracle.of_one_robot(both).distance_m > self_stop + 0.02


def test_a_held_leader_turns_elsewhere() -> None:
    leader = ScriptedLeader(GR, CYCLE_S, 0.25, 0)
    q = np.array(GR.home)
    wanted = [leader.increment(View(RobotView(cycle, cycle * CYCLE_S, q, q))) for cycle in range(200)]
    directions = np.array([dq / np.linalg.norm(dq) for dq in wanted if np.linalg.norm(dq) > 1e-6])
    assert (directions @ directions[0]).min() < 0.7


def test_a_leader_without_speed_stands_still() -> None:
    _, positions = lead(ScriptedLeader(GR, CYCLE_S, 0.0, 0), 1.0)
    assert np.ptp(positions, axis=0).max() < 1e-9


@pytest.mark.parametrize("speed_m_s", [-0.1, float("nan"), float("inf")])
def test_an_invalid_speed_is_refused(speed_m_s: float) -> None:
    with pytest.raises(ControllerError, match="speed_m_s must be a finite number"):
        ScriptedLeader(GR, CYCLE_S, speed_m_s)


@pytest.mark.parametrize("stick_m_s2", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_acceleration_is_refused(stick_m_s2: float) -> None:
    with pytest.raises(ControllerError, match=r"stick_m_s2 must be a finite number of m/s\^2 above 0"):
        ScriptedLeader(GR, CYCLE_S, stick_m_s2=stick_m_s2)
    with pytest.raises(ControllerError, match="stick_m_s2"):
        AttackingLeader(GR, lab().robots["fr"], CYCLE_S, stick_m_s2=stick_m_s2)


def test_an_invalid_workspace_is_refused() -> None:
    with pytest.raises(ControllerError, match="workspace"):
        Joystick(0.25, 0, Workspace((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)), CYCLE_S)
