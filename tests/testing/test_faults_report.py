"""Judging a fault from setpoints: a judge that cannot say no is none."""

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_emulator.catalogue import Code, KrcMessage
from deltaq_testing.faults.panel import pendant_message
from deltaq_testing.faults.report import is_good, judged, motion_after

CYCLE_S = 0.012
CRUISE = np.deg2rad(30) * CYCLE_S
STOP_DISTANCES_M = (0.05, 0.02)


@pytest.fixture(scope="module")
def robot():
    return CellModel.load("lab").robots["fr"]


def setpoints(robot, steps):
    """A1 moves by `steps`, from home."""
    q = np.tile(robot.home, (len(steps) + 1, 1))
    q[1:, 0] += np.cumsum(steps)
    return q


def judge(robot, steps, unanswered=0, near=(0.1, 0.1), protest=None, altered=0, altered_replies=False):
    return judged(
        robot, setpoints(robot, steps), CYCLE_S, unanswered, near, protest, altered, altered_replies
    )


def test_a_brake_is_measured_from_the_fault_to_the_last_increment(robot):
    steps = [CRUISE] * 2 + [CRUISE * (4 - k) / 4 for k in range(1, 5)] + [0.0] * 20
    motion = motion_after(robot, setpoints(robot, steps), CYCLE_S, CRUISE)
    assert motion.braked_after_cycles == 3
    assert motion.rest_after_s == pytest.approx(5 * CYCLE_S)
    assert motion.travel_rad == pytest.approx(3.5 * CRUISE)
    assert motion.travel_tool_m > 0


def test_a_robot_in_motion_until_the_end_has_no_rest_time(robot):
    motion = motion_after(robot, setpoints(robot, [CRUISE] * 30), CYCLE_S, CRUISE)
    assert (motion.braked_after_cycles, motion.rest_after_s) == (None, None)


def test_an_abrupt_stop_is_good_only_without_a_reply_or_with_an_altered_telegram(robot):
    steps = [CRUISE] * 10 + [0.0] * 10
    changes = [steps[0], *np.diff(steps)]
    assert max(np.abs(changes)) > robot.max_acceleration[0] * CYCLE_S**2
    assert not is_good(judge(robot, steps), STOP_DISTANCES_M)
    assert is_good(judge(robot, steps, unanswered=1), STOP_DISTANCES_M)
    assert is_good(judge(robot, steps, altered=1), STOP_DISTANCES_M)
    assert not is_good(judge(robot, [*steps[:-1], CRUISE, 0.0], altered=1), STOP_DISTANCES_M)


def test_a_step_beyond_the_velocity_limit_is_never_good(robot):
    fast = robot.max_velocity[0] * CYCLE_S * 1.1
    assert judge(robot, [fast] * 5).velocity_violations == 5
    assert not is_good(judge(robot, [fast] * 5, unanswered=100), STOP_DISTANCES_M)


def test_with_altered_replies_only_distances_are_judged(robot):
    fast = [robot.max_velocity[0] * CYCLE_S * 1.1] * 5
    for near, good in (((0.1, 0.1), True), ((0.049, 0.1), False), ((0.1, 0.019), False)):
        altered = judge(robot, fast, near=near, protest="Command gear torque", altered_replies=True)
        assert is_good(altered, STOP_DISTANCES_M) is good


@pytest.mark.parametrize("near", [(0.049, 0.1), (0.1, 0.019)])
def test_too_near_bodies_are_not_good(robot, near):
    assert not is_good(judge(robot, [0.0] * 5, near=near), STOP_DISTANCES_M)


def test_a_setpoint_refused_by_the_krc_is_not_good(robot):
    refused = str(KrcMessage(Code.GEAR_TORQUE, "A1", 12495.0, 10416.0, "deg"))
    assert pendant_message(refused) == refused
    assert not is_good(judge(robot, [0.0] * 5, protest=pendant_message(refused)), STOP_DISTANCES_M)


@pytest.mark.parametrize("code", [Code.LATE_PACKETS, Code.OPERATOR_STOP, Code.DRIVES_OFF])
def test_a_stop_by_an_operator_or_a_lost_link_is_no_refused_setpoint(code):
    assert pendant_message(str(KrcMessage(code, "", 101, 100))) is None
