"""The last look at a reply: whatever was decided before, nothing but a small step inside the limits is sent."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_services.robot_server.reply_guard import ReplyFault, reply_fault

MOST = (0.1, 0.2)
LOWER, UPPER = (-1.0, -2.0), (1.0, 2.0)


def fault(correction, last=(0.0, 0.0)):
    return reply_fault(correction, last, MOST, LOWER, UPPER)


@pytest.mark.parametrize("correction", [(0.0, 0.0), (0.1, 0.2), (-0.1, -0.2), (0.1 * (1 + 5e-7), 0.0)])
def test_what_a_joint_may_travel_in_a_cycle_is_sent(correction):
    assert fault(correction) is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", [0, 1])
def test_what_is_not_finite_is_refused(value, joint):
    correction = [0.0, 0.0]
    correction[joint] = value
    found = fault(correction)
    assert (found.joint, found.what, found.bound) == (joint, "is not finite", MOST[joint])
    assert found.value is value


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_leap_is_refused_from_wherever_it_starts(joint, sign):
    last = [0.3, -0.4]
    correction = list(last)
    correction[joint] += sign * (MOST[joint] + 1e-6)
    found = fault(correction, last)
    assert (found.joint, found.what, found.bound) == (joint, "leaps", MOST[joint])
    assert found.value == pytest.approx(sign * (MOST[joint] + 1e-6))


@pytest.mark.parametrize("joint", [0, 1])
def test_a_correction_beyond_its_limits_is_refused(joint):
    for bounds, sign, what in ((UPPER, 1, "is above its limit"), (LOWER, -1, "is below its limit")):
        last = [0.0, 0.0]
        last[joint] = bounds[joint]
        correction = list(last)
        correction[joint] += sign * 1e-8
        assert fault(correction, last) == ReplyFault(joint, what, correction[joint], bounds[joint])
        correction[joint] = bounds[joint] + sign * 1e-10
        assert fault(correction, last) is None


def test_from_outside_its_limits_a_correction_may_stay_and_come_back_and_not_go_further():
    for sign in (1, -1):
        last = (sign * 1.5, 0.0)
        assert fault(last, last) is None
        assert fault((sign * 1.45, 0.0), last) is None
        assert fault((sign * 1.55, 0.0), last) is not None


def test_a_fault_says_joint_value_and_bound():
    found = fault((0.0, 0.25))
    assert str(found) == "correction of joint 2 leaps: 0.25, allowed 0.2 (rad or m)"


@given(st.lists(st.floats(), min_size=2, max_size=2), st.lists(st.floats(-1, 1), min_size=2, max_size=2))
def test_what_is_let_pass_is_a_small_step_inside_the_limits(correction, last):
    if fault(correction, last) is None:
        for joint in (0, 1):
            assert abs(correction[joint] - last[joint]) <= MOST[joint] * (1 + 1e-6)
            assert LOWER[joint] - 1e-9 <= correction[joint] <= UPPER[joint] + 1e-9
