"""The Robot Server's own guards, at their bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_cell import admission_after, server_state

from deltaq_cell.load import load_cell
from deltaq_protocol import topics
from deltaq_services.robot_server.guards import Bounds, Refusal, refusal
from deltaq_services.robot_server.reply_guard import reply_fault
from deltaq_services.robot_server.session import (
    LIMIT_MARGIN_M,
    LIMIT_MARGIN_RAD,
    RESOLUTION_M,
    RESOLUTION_RAD,
    VELOCITY_MARGIN,
    Plausibility,
)

MAX_DQ, MAX_DV = np.full(6, 0.016), np.full(6, 0.001)
BOUNDS = Bounds(lower=np.full(6, -1.0), upper=np.full(6, 2.0), max_dq=MAX_DQ, max_dv=MAX_DV)


def answer(q=0.0, last=0.0, dq=0.0, brake_cycles=1, age_cycles=0):
    """What is said to an increment of all joints, by a robot whose setpoint is at `q` after an increment `last`."""
    state = server_state(q_cmd=(q,) * 6, dq=(last,) * 6)
    admission = admission_after(state, (dq,) * 6, brake_cycles, cycle=state.cycle - age_cycles)
    return refusal(admission, state, BOUNDS)


def last_setpoint(q, dq, brake_cycles):
    """Where the brake after `dq` ends, step by step."""
    for step in range(brake_cycles + 1):
        q += dq * (brake_cycles - step) / brake_cycles
    return q


@pytest.mark.parametrize("sign", [1, -1])
def test_full_speed_is_permitted_and_no_more(sign):
    assert answer(last=sign * 0.0155, dq=sign * 0.016, brake_cycles=16) is None
    assert answer(last=sign * 0.0155, dq=sign * 0.01601, brake_cycles=17) is Refusal.TOO_FAST


@pytest.mark.parametrize("sign", [1, -1])
def test_the_increment_may_change_by_the_acceleration_limit_and_no_more(sign):
    assert answer(last=sign * 0.002, dq=sign * 0.003, brake_cycles=3) is None
    assert answer(last=sign * 0.002, dq=sign * 0.00301, brake_cycles=4) is Refusal.TOO_ABRUPT
    assert answer(last=sign * 0.002, dq=sign * 0.00099, brake_cycles=4) is Refusal.TOO_ABRUPT


def test_a_brake_of_the_required_length_is_accepted_and_a_shorter_one_is_not():
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
def test_beyond_a_limit_a_joint_may_stand_and_return_but_not_go_further(outside, sign):
    assert answer(q=outside, dq=0.0) is None
    assert answer(q=outside, dq=-sign * 0.0005) is None
    assert answer(q=outside, dq=sign * 0.0005) is Refusal.LEAVES_LIMITS


def test_a_joint_outside_one_limit_does_not_open_the_other():
    state_far_up = answer(q=2.1, last=-0.0155, dq=-0.016, brake_cycles=10_000)
    assert state_far_up is Refusal.LEAVES_LIMITS


@pytest.mark.parametrize("max_age_cycles", [0, 2])
def test_an_admission_has_a_greatest_age_and_never_a_future_cycle(monkeypatch, max_age_cycles):
    monkeypatch.setattr(topics, "ADMISSION", replace(topics.ADMISSION, max_age_cycles=max_age_cycles))
    assert answer(age_cycles=max_age_cycles) is None
    assert answer(age_cycles=max_age_cycles + 1) is Refusal.LATE
    assert answer(age_cycles=-1) is Refusal.LATE


# The last look at a reply: whatever was decided before, nothing but a small step inside the limits is sent.

MOST = (0.1, 0.2)
LOWER, UPPER = (-1.0, -2.0), (1.0, 2.0)


def fault(correction, last=(0.0, 0.0)):
    return reply_fault(correction, last, MOST, LOWER, UPPER)


def refused(joint, what, value, bound):
    return f"correction of joint {joint + 1} {what}: {value:.6g}, allowed {bound:.6g} (rad or m)"


@pytest.mark.parametrize("correction", [(0.0, 0.0), (0.1, 0.2), (-0.1, -0.2), (0.1 * (1 + 5e-7), 0.0)])
def test_a_correction_within_a_joints_travel_is_sent(correction):
    assert fault(correction) is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_non_finite_value_is_refused(value, joint):
    correction = [0.0, 0.0]
    correction[joint] = value
    assert fault(correction) == refused(joint, "is not finite", value, MOST[joint])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_jump_is_refused_from_any_start(joint, sign):
    last = [0.3, -0.4]
    correction = list(last)
    correction[joint] += sign * (MOST[joint] + 1e-6)
    assert fault(correction, last) == refused(joint, "leaps", sign * (MOST[joint] + 1e-6), MOST[joint])


@pytest.mark.parametrize("joint", [0, 1])
def test_a_correction_beyond_its_limits_is_refused(joint):
    for bounds, sign, what in ((UPPER, 1, "is above its limit"), (LOWER, -1, "is below its limit")):
        last = [0.0, 0.0]
        last[joint] = bounds[joint]
        correction = list(last)
        correction[joint] += sign * 1e-8
        assert fault(correction, last) == refused(joint, what, correction[joint], bounds[joint])
        correction[joint] = bounds[joint] + sign * 1e-10
        assert fault(correction, last) is None


def test_beyond_its_limits_a_correction_may_stay_and_return_but_not_go_further():
    for sign in (1, -1):
        last = (sign * 1.5, 0.0)
        assert fault(last, last) is None
        assert fault((sign * 1.45, 0.0), last) is None
        assert fault((sign * 1.55, 0.0), last) is not None


def test_a_fault_says_joint_value_and_bound():
    found = fault((0.0, 0.25))
    assert str(found) == "correction of joint 2 leaps: 0.25, allowed 0.2 (rad or m)"


@given(st.lists(st.floats(), min_size=2, max_size=2), st.lists(st.floats(-1, 1), min_size=2, max_size=2))
def test_an_accepted_correction_is_a_small_step_inside_the_limits(correction, last):
    if fault(correction, last) is None:
        for joint in (0, 1):
            assert abs(correction[joint] - last[joint]) <= MOST[joint] * (1 + 1e-6)
            assert LOWER[joint] - 1e-9 <= correction[joint] <= UPPER[joint] + 1e-9


# What can be true of a reported position.

CELL = load_cell("lab")
GR = CELL.robots["gr"]
LINEAR = np.array([unit == "m" for unit in GR.units])
MARGIN = np.where(LINEAR, LIMIT_MARGIN_M, LIMIT_MARGIN_RAD)


@pytest.fixture
def plausible():
    """Made for each test: what a module makes as it is read is made once, whatever is tried on the code later."""
    return Plausibility.of(GR, CELL.cycle_s)


def with_joint(q, joint, value):
    changed = q.copy()
    changed[joint] = value
    return changed.tolist()


@pytest.mark.parametrize("joint", range(9))
def test_a_position_is_plausible_up_to_the_limit_plus_a_margin(plausible, joint):
    for bound, sign, word in ((GR.lower - MARGIN, -1, "below"), (GR.upper + MARGIN, 1, "above")):
        assert plausible.of_place(with_joint(GR.home, joint, bound[joint] - sign * 1e-9)) is None
        beyond = bound[joint] + sign * 1e-6
        told = f"{GR.joint_names[joint]} is {word} its limit and a margin: {beyond:.6g}, allowed {bound[joint]:.6g}"
        assert plausible.of_place(with_joint(GR.home, joint, beyond)).startswith(told)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_non_finite_position_is_implausible(plausible, value):
    assert plausible.of_place(with_joint(GR.home, 4, value)).startswith("a2 ")
    assert plausible.of_motion(with_joint(GR.home, 4, value), GR.home.tolist(), 1).startswith("a2 ")


@pytest.mark.parametrize("joint", range(9))
@pytest.mark.parametrize("cycles", [1, 7])
def test_a_position_is_plausible_within_the_possible_motion_since_the_last(plausible, joint, cycles):
    resolution = RESOLUTION_M if LINEAR[joint] else RESOLUTION_RAD
    reach = VELOCITY_MARGIN * cycles * CELL.cycle_s * GR.max_velocity[joint] + resolution
    home = GR.home.tolist()
    for sign in (1, -1):
        near, far = (GR.home[joint] + sign * reach * share for share in (1 - 1e-6, 1 + 1e-6))
        assert plausible.of_motion(with_joint(GR.home, joint, near), home, cycles) is None
        told = f"{GR.joint_names[joint]} cannot have moved so far in {cycles} cycles: {abs(far - home[joint]):.6g}, "
        assert plausible.of_motion(with_joint(GR.home, joint, far), home, cycles).startswith(told)


def test_a_position_exactly_at_its_bounds_is_plausible(plausible):
    assert plausible.of_place(plausible.lower) is None
    assert plausible.of_place(plausible.upper) is None
    furthest = [
        3 * reach + rounding for reach, rounding in zip(plausible.reach, plausible.resolution, strict=True)
    ]
    assert plausible.of_motion(furthest, [0.0] * 9, 3) is None


@pytest.mark.parametrize("joints", [6, 10])
def test_a_position_with_a_wrong_number_of_joints_is_an_error(plausible, joints):
    with pytest.raises(ValueError, match="argument"):
        plausible.of_place([0.0] * joints)
