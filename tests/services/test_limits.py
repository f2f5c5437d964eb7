"""I1 and I3: how much of a request fits between the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_cell.load import load_cell
from deltaq_protocol.brake import brake_cycles, brake_travel
from deltaq_protocol.messages import Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.limits import Limits, share_within, shares_within

CELL = load_cell("lab")
FR = CELL.robots["fr"]
LIMITS = Limits.of(FR, CELL.cycle_s)
NONE = np.zeros(6)
shares = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array)

QUARTER = 0.25
TWO_JOINTS = Limits(
    joint_names=("a1", "a2"),
    lower=np.full(2, -8.0),
    upper=np.full(2, 8.0),
    max_dq=np.full(2, 16 * QUARTER),
    max_dv=np.full(2, QUARTER),
    cycle_s=0.5,
)
"""Numbers that floats hold exactly, so that bounds can be met to the bit."""


def both(a1, a2):
    return np.array([a1, a2], dtype=float)


def test_a_robot_s_limits_hold_for_one_cycle_however_long_it_is():
    for cycle_s in (0.004, 0.012):
        limits = Limits.of(FR, cycle_s)
        assert limits.max_dq / cycle_s == pytest.approx(FR.max_velocity)
        assert limits.max_dv / cycle_s / cycle_s == pytest.approx(FR.max_acceleration)
        np.testing.assert_array_equal([limits.lower, limits.upper], [FR.lower, FR.upper])
        assert (limits.joint_names, limits.cycle_s) == (FR.joint_names, cycle_s)


def test_a_share_is_the_distance_to_the_bound_in_the_direction_of_motion():
    start, end = np.zeros(4), np.array([4.0, -4.0, 0.0, 1.0])
    shares = shares_within(start, end, np.full(4, -1.0), np.full(4, 2.0))
    np.testing.assert_array_equal(shares, [0.5, 0.25, 1.0, 2.0])


@pytest.mark.parametrize("sign", [1, -1])
def test_slow_motion_is_a_share_of_each_speed_limit_and_zero_during_a_faster_brake(sign):
    slow = TWO_JOINTS.max_dq[0] / 4
    assert TWO_JOINTS.slow_scale(both(0, 0), sign * both(2 * slow, 4 * slow), 0.25) == 0.25
    assert TWO_JOINTS.slow_scale(both(0, 0), sign * both(slow, 0), 0.25) == 1.0
    assert TWO_JOINTS.slow_scale(both(0, sign * slow), sign * both(slow, 3 * slow), 0.25) == 0.0
    too_fast = sign * both(0, 1.5 * slow)
    assert TWO_JOINTS.slow_scale(too_fast, both(0, 0), 0.25) == 0.0
    assert TWO_JOINTS.slow_scale(sign * both(0, slow), both(0, 0), 0.25) == 1.0


def test_the_common_share_is_the_least_of_all_joints_and_at_most_one():
    low, high = np.full(2, -1.0), np.full(2, 2.0)
    assert share_within(np.zeros(2), both(4, 8), low, high) == 0.25
    assert share_within(np.zeros(2), both(0.5, 0.5), low, high) == 1.0
    assert share_within(both(2 + 1e-12, 0), both(4, 0), low, high) == 0.0


def test_a_request_within_all_limits_is_admitted_in_full():
    assert LIMITS.dynamic_scale(NONE, 0.9 * LIMITS.max_dv, NONE) == (1.0, [])


def test_a_request_exactly_at_its_bounds_is_admitted_in_full():
    last = both(15.5, -15.5) * QUARTER
    assert TWO_JOINTS.dynamic_scale(0.9 * last, both(16, -16) * QUARTER, last) == (1.0, [])
    assert TWO_JOINTS.dynamic_scale(NONE[:2], both(QUARTER, 0), NONE[:2]) == (1.0, [])


@pytest.mark.parametrize("sign", [1, -1])
def test_from_rest_a_request_beyond_both_bounds_is_bound_by_acceleration(sign):
    scale, reasons = TWO_JOINTS.dynamic_scale(NONE[:2], both(0, sign * 32 * QUARTER), NONE[:2])
    assert scale == 1 / 32
    assert reasons == [
        Reason(code=ReasonCode.ACCELERATION_LIMIT, what="a2", value=32 * QUARTER / 0.25, bound=QUARTER / 0.25)
    ]


@pytest.mark.parametrize("sign", [1, -1])
def test_in_motion_acceleration_is_reported_as_the_change_from_the_last_increment(sign):
    last, brake, request = (
        sign * both(8, 0) * QUARTER,
        sign * both(7, 0) * QUARTER,
        sign * both(11, 0) * QUARTER,
    )
    scale, reasons = TWO_JOINTS.dynamic_scale(brake, request, last)
    assert scale == 0.5
    assert reasons == [
        Reason(code=ReasonCode.ACCELERATION_LIMIT, what="a1", value=3 * QUARTER / 0.25, bound=QUARTER / 0.25)
    ]


@pytest.mark.parametrize("sign", [1, -1])
def test_at_full_speed_a_faster_request_is_bound_by_velocity(sign):
    last, brake, request = (sign * both(count, 0) * QUARTER for count in (16, 15, 20))
    scale, reasons = TWO_JOINTS.dynamic_scale(brake, request, last)
    assert scale == 0.2
    assert reasons == [
        Reason(code=ReasonCode.VELOCITY_LIMIT, what="a1", value=20 * QUARTER / 0.5, bound=16 * QUARTER / 0.5)
    ]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_turn_at_full_speed_is_bound_by_acceleration(sign):
    last, brake = sign * both(16, 0) * QUARTER, sign * both(15, 0) * QUARTER
    scale, reasons = TWO_JOINTS.dynamic_scale(brake, -1.25 * last, last)
    assert scale == 0.0
    assert reasons[0].code is ReasonCode.ACCELERATION_LIMIT


def test_a_brake_rounded_beyond_its_bound_leaves_no_share():
    last = both(8, 0) * QUARTER
    brake = last - both(1 + 1e-12, 0) * QUARTER
    scale, _ = TWO_JOINTS.dynamic_scale(brake, -last, last)
    assert scale == 0.0


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


@pytest.mark.long
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


def test_a_joint_beyond_its_limit_may_return_but_not_go_further():
    q_cmd = FR.home.copy()
    q_cmd[0] = FR.upper[0] + 0.1
    inward = np.array([-LIMITS.max_dv[0], 0, 0, 0, 0, 0])
    assert LIMITS.position_scale(NONE, inward, q_cmd, 1.0)[0] == 1.0
    assert LIMITS.position_scale(NONE, -inward, q_cmd, 1.0)[0] == 0.0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("count", [0.5, 1, 3])
def test_a_brake_may_end_on_a_position_limit_and_not_beyond(sign, count):
    request = sign * both(count, 0) * QUARTER
    travel = request + brake_travel(request, max(1, int(count)), 0)
    on_limit = sign * 8.0 - travel
    assert TWO_JOINTS.position_scale(NONE[:2], request, on_limit, 1.0) == (1.0, [])
    scale, reasons = TWO_JOINTS.position_scale(NONE[:2], request, on_limit + sign * 1e-6, 1.0)
    assert 0.98 < scale < 1.0
    told = reasons[0]
    assert (told.code, told.what, told.bound) == (ReasonCode.POSITION_LIMIT, "a1", sign * 8.0)
    assert told.value == pytest.approx(sign * 8.0 + sign * 1e-6, abs=1e-9)


@given(shares, shares, st.floats(0.0, 0.05), st.floats(0.0, 1.0))
def test_position_takes_the_greatest_share_whose_brake_ends_inside(last_share, request_share, room, at_most):
    """To a 128th, against the brake that Robot Servers drive."""
    last, request = last_share * LIMITS.max_dq, request_share * LIMITS.max_dq
    brake = last * (1 - 1 / LIMITS.brake_cycles(last))
    toward = np.where(request >= 0, FR.upper, FR.lower)
    q_cmd = toward + room * (FR.home - toward) - brake - brake_travel(brake, LIMITS.brake_cycles(brake), 0)

    def inside(scale):
        dq = brake + scale * (request - brake)
        end = q_cmd + dq + brake_travel(dq, brake_cycles(dq, LIMITS.max_dv), 0)
        low, high = np.minimum(FR.lower, q_cmd), np.maximum(FR.upper, q_cmd)
        return bool(np.all((end >= low - 1e-11) & (end <= high + 1e-11)))

    scale, reasons = LIMITS.position_scale(brake, request, q_cmd, at_most)
    assert 0.0 <= scale <= at_most
    assert bool(reasons) == (not inside(at_most))
    if scale > 0:
        assert inside(scale)
    greater = [k / 128 for k in range(129) if scale + 1e-9 < k / 128 < at_most - 1e-9]
    assert not any(inside(share) for share in greater)


@pytest.mark.parametrize("at_most", [0.0, 1e-3, 1.0])
def test_a_brake_that_ends_outside_leaves_no_share(at_most):
    brake = both(3, 0) * QUARTER
    scale, reasons = TWO_JOINTS.position_scale(brake, 4 / 3 * brake, both(7.5, 0), at_most)
    assert scale == 0.0
    dq = brake * (1 + at_most / 3)
    end = 7.5 + dq + brake_travel(dq, TWO_JOINTS.brake_cycles(dq), 0)
    assert (reasons[0].what, reasons[0].value) == ("a1", pytest.approx(end[0]))


def test_the_reported_end_is_that_of_the_requested_motion():
    """At the least share of the request another joint would be the one that ends outside."""
    brake, request = both(0, 2) * QUARTER, both(16, 2) * QUARTER
    scale, reasons = TWO_JOINTS.position_scale(brake, request, both(7.9, 7.9), 1.0)
    assert scale == 0.0
    assert reasons[0].what == "a1"
