import numpy as np
import pytest
from closed_loop import CYCLE_S, lab, limit_violations
from hypothesis import given, settings
from hypothesis import strategies as st

from deltaq_cell.robot import RobotModel
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.modes.programme import admits
from deltaq_protocol.brake import brake_cycles, brake_travel

ROBOTS = list(lab().robots.values())


def stays_inside_when_braked(robot: RobotModel, q: np.ndarray, dq: np.ndarray) -> bool:
    cycles = brake_cycles(dq, CYCLE_S**2 * robot.max_acceleration)
    end = q + dq + brake_travel(dq, cycles, 0)
    return bool((end <= robot.upper).all() and (end >= robot.lower).all())


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.sampled_from(ROBOTS), st.integers(0, 2**32 - 1), st.floats(0.01, 50.0), st.integers(1, 60))
def test_for_any_request_increments_keep_limits_and_can_be_braked(
    robot: RobotModel, seed: int, scale: float, hold: int
) -> None:
    random = np.random.default_rng(seed)
    limits = IncrementLimits.of(robot, CYCLE_S)
    q, dq = np.array(robot.home), np.zeros(robot.n)
    for cycle in range(240):
        if cycle % hold == 0:
            wanted = scale * random.normal(size=robot.n) * CYCLE_S * robot.max_velocity
        increment = limits.admissible(wanted, q, dq)
        assert limit_violations(robot, q, increment, dq) == 0
        assert stays_inside_when_braked(robot, q, increment)
        q, dq = q + increment, increment


@pytest.mark.parametrize("robot", ROBOTS)
def test_an_obviously_admissible_increment_is_returned_unchanged(robot: RobotModel) -> None:
    random, limits = np.random.default_rng(5), IncrementLimits.of(robot, CYCLE_S)
    count = {True: 0, False: 0}
    for _ in range(400):
        near = random.uniform(0.0, 1.0, robot.n) ** 4  # often near a limit
        q = np.where(random.random(robot.n) < 0.5, robot.lower, robot.upper)
        q = q + near * (0.5 * (robot.lower + robot.upper) - q)
        last = limits.admissible(random.normal(size=robot.n) * limits.max_dq, q, np.zeros(robot.n))
        wanted = last + random.normal(size=robot.n) * limits.max_ddq
        for dq in (wanted, limits.admissible(wanted, q, last)):
            is_admitted = admits(limits, q, dq, last)
            count[is_admitted] += 1
            if is_admitted:
                np.testing.assert_array_equal(limits.admissible(dq, q, last), dq)
    assert min(count.values()) > 50


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("side", [-1, 1])
def test_a_robot_at_its_limits_may_only_leave_them(robot: RobotModel, side: int) -> None:
    limits = IncrementLimits.of(robot, CYCLE_S)
    at_limit = np.array(robot.upper if side > 0 else robot.lower)
    out = limits.admissible(np.full(robot.n, side * 1.0), at_limit, np.zeros(robot.n))
    assert (side * out <= 0.0).all()
    back = limits.admissible(np.full(robot.n, side * -1.0), at_limit, np.zeros(robot.n))
    assert (side * back < 0.0).all()


def test_a_joint_reaches_its_limit_and_stops_there() -> None:
    robot = ROBOTS[0]
    limits = IncrementLimits.of(robot, CYCLE_S)
    q, dq = np.array(robot.home), np.zeros(robot.n)
    for _ in range(600):
        dq = limits.admissible(np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), q, dq)
        q = q + dq
    assert np.abs(dq).max() < 1e-6
    assert robot.upper[4] - 2e-3 < q[4] <= robot.upper[4]
