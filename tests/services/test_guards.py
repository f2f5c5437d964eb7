"""The Robot Server's own guards, at their bounds."""

from dataclasses import replace

import numpy as np
import pytest
from small_cell import server_state

from deltaq_protocol import topics
from deltaq_protocol.guarded import Admission
from deltaq_services.robot_server.guards import Bounds, Refusal, refusal

MAX_DQ, MAX_DV = np.full(6, 0.016), np.full(6, 0.001)
BOUNDS = Bounds(lower=np.full(6, -1.0), upper=np.full(6, 2.0), max_dq=MAX_DQ, max_dv=MAX_DV)


def answer(q=0.0, last=0.0, dq=0.0, brake_cycles=1, age_cycles=0):
    """What is said to an increment of all joints, by a robot whose setpoint is at `q` after an increment `last`."""
    state = server_state(q_cmd=(q,) * 6, dq=(last,) * 6)
    admission = Admission(
        robot="fr",
        epoch=state.epoch,
        sequence=state.sequence + 1,
        cycle=state.cycle - age_cycles,
        follows_sequence=state.sequence,
        follows_q_cmd=state.q_cmd,
        follows_dq=state.dq,
        follows_resets=state.resets,
        dq=(dq,) * 6,
        brake_cycles=brake_cycles,
    )
    return refusal(admission, state, BOUNDS)


def last_setpoint(q, dq, brake_cycles):
    """Where the brake after `dq` ends, step by step."""
    for step in range(brake_cycles + 1):
        q += dq * (brake_cycles - step) / brake_cycles
    return q


@pytest.mark.parametrize("sign", [1, -1])
def test_full_speed_may_be_reached_and_not_passed(sign):
    assert answer(last=sign * 0.0155, dq=sign * 0.016, brake_cycles=16) is None
    assert answer(last=sign * 0.0155, dq=sign * 0.01601, brake_cycles=17) is Refusal.TOO_FAST


@pytest.mark.parametrize("sign", [1, -1])
def test_the_increment_may_change_by_the_acceleration_limit_and_no_more(sign):
    assert answer(last=sign * 0.002, dq=sign * 0.003, brake_cycles=3) is None
    assert answer(last=sign * 0.002, dq=sign * 0.00301, brake_cycles=4) is Refusal.TOO_ABRUPT
    assert answer(last=sign * 0.002, dq=sign * 0.00099, brake_cycles=4) is Refusal.TOO_ABRUPT


def test_a_brake_of_as_many_cycles_as_the_deceleration_limit_asks_is_taken_and_a_shorter_one_is_not():
    assert answer(last=0.002, dq=0.003, brake_cycles=3) is None
    assert answer(last=0.002, dq=0.003, brake_cycles=2) is Refusal.BRAKE_TOO_ABRUPT


@pytest.mark.parametrize("brake_cycles", [8, 12])
@pytest.mark.parametrize(("limit", "sign"), [(2.0, 1), (-1.0, -1)])
def test_the_last_setpoint_of_the_brake_may_lie_on_a_limit_and_not_beyond(limit, sign, brake_cycles):
    travel = last_setpoint(0.0, 0.008, brake_cycles)
    on_limit = limit - sign * travel
    move = {"last": sign * 0.0075, "dq": sign * 0.008, "brake_cycles": brake_cycles}
    assert answer(q=on_limit, **move) is None
    assert answer(q=on_limit + sign * 1e-7, **move) is Refusal.LEAVES_LIMITS


@pytest.mark.parametrize(("outside", "sign"), [(2.1, 1), (-1.1, -1)])
def test_outside_a_limit_it_may_stand_and_come_back_and_not_go_further_out(outside, sign):
    assert answer(q=outside, dq=0.0) is None
    assert answer(q=outside, dq=-sign * 0.0005) is None
    assert answer(q=outside, dq=sign * 0.0005) is Refusal.LEAVES_LIMITS


def test_a_joint_outside_one_limit_does_not_open_the_other():
    state_far_up = answer(q=2.1, last=-0.0155, dq=-0.016, brake_cycles=10_000)
    assert state_far_up is Refusal.LEAVES_LIMITS


@pytest.mark.parametrize("max_age_cycles", [0, 2])
def test_an_admission_may_be_as_old_as_the_table_of_topics_says_and_is_never_of_a_cycle_to_come(
    monkeypatch, max_age_cycles
):
    monkeypatch.setattr(topics, "ADMISSION", replace(topics.ADMISSION, max_age_cycles=max_age_cycles))
    assert answer(age_cycles=max_age_cycles) is None
    assert answer(age_cycles=max_age_cycles + 1) is Refusal.LATE
    assert answer(age_cycles=-1) is Refusal.LATE
