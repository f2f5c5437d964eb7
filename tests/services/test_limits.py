"""I1 and I3: how much of a request fits between the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_cell.load import load_cell
from deltaq_protocol.brake import brake_travel
from deltaq_services.sim.limits import Limits

CELL = load_cell("lab")
FR = CELL.robots["fr"]
LIMITS = Limits.of(FR, CELL.cycle_s)
NONE = np.zeros(6)
shares = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array)


def test_a_request_within_all_limits_is_taken_whole():
    assert LIMITS.dynamic_scale(NONE, 0.9 * LIMITS.max_dv, NONE) == (1.0, [])


def test_an_acceleration_names_its_joint_value_and_bound():
    request = np.array([0, 0, 4 * LIMITS.max_dv[2], 0, 0, 0])
    scale, reasons = LIMITS.dynamic_scale(NONE, request, NONE)
    assert scale == pytest.approx(0.25)
    assert (reasons[0].code, reasons[0].what) == ("acceleration_limit", "a3")
    assert reasons[0].value == pytest.approx(4 * FR.max_acceleration[2])
    assert reasons[0].bound == pytest.approx(FR.max_acceleration[2])


def test_a_velocity_names_its_joint_value_and_bound():
    last = np.array([LIMITS.max_dq[0], 0, 0, 0, 0, 0])
    brake = last - np.array([LIMITS.max_dv[0], 0, 0, 0, 0, 0])
    scale, reasons = LIMITS.dynamic_scale(brake, 1.05 * last, last)
    assert 0 < scale < 1
    assert (reasons[0].code, reasons[0].what) == ("velocity_limit", "a1")
    assert reasons[0].value == pytest.approx(1.05 * FR.max_velocity[0])


@given(shares, shares)
def test_the_blend_never_passes_velocity_or_acceleration(last_share, request_share):
    last = last_share * LIMITS.max_dq
    cycles = LIMITS.brake_cycles(last)
    brake = last * ((cycles - 1) / cycles)
    request = 3 * request_share * LIMITS.max_dq
    scale, _ = LIMITS.dynamic_scale(brake, request, last)
    dq = brake + scale * (request - brake)
    assert 0.0 <= scale <= 1.0
    assert np.all(np.abs(dq) <= LIMITS.max_dq * (1 + 1e-6))
    assert np.all(np.abs(dq - last) <= LIMITS.max_dv * (1 + 1e-6))


@given(shares, shares, st.floats(0.0, 0.3))
def test_the_blend_can_be_braked_inside_the_position_limits(where, request_share, room):
    middle, half = (FR.upper + FR.lower) / 2, (FR.upper - FR.lower) / 2
    q_cmd = middle + where * half * (1 - room)
    request = request_share * LIMITS.max_dq
    scale, reasons = LIMITS.position_scale(NONE, request, q_cmd, 1.0)
    dq = scale * request
    end = q_cmd + dq + brake_travel(dq, LIMITS.brake_cycles(dq), 0)
    assert np.all(end <= FR.upper + 1e-9)
    assert np.all(end >= FR.lower - 1e-9)
    assert bool(reasons) == (scale < 1.0)


def test_a_position_names_its_joint_the_end_of_the_brake_and_the_limit():
    q_cmd = FR.home.copy()
    q_cmd[4] = FR.upper[4] - 0.01
    request = np.array([0, 0, 0, 0, 0.5 * LIMITS.max_dq[4], 0])
    scale, reasons = LIMITS.position_scale(NONE, request, q_cmd, 1.0)
    assert scale < 1
    assert (reasons[0].code, reasons[0].what) == ("position_limit", "a5")
    assert reasons[0].value > reasons[0].bound == pytest.approx(FR.upper[4])


def test_a_joint_outside_its_limit_may_come_back_and_may_not_go_further_out():
    q_cmd = FR.home.copy()
    q_cmd[0] = FR.upper[0] + 0.1
    inward = np.array([-LIMITS.max_dv[0], 0, 0, 0, 0, 0])
    assert LIMITS.position_scale(NONE, inward, q_cmd, 1.0)[0] == 1.0
    assert LIMITS.position_scale(NONE, -inward, q_cmd, 1.0)[0] == 0.0
