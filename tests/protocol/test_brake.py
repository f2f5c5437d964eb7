"""The brake formula that gate and Robot Server share."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol.brake import brake_cycles, brake_increment, brake_travel

increments = st.lists(st.floats(-0.05, 0.05), min_size=1, max_size=9).map(np.array)


@given(increments)
def test_the_brake_keeps_every_deceleration_and_ends_at_rest(dq):
    max_dv = np.linspace(0.0005, 0.002, dq.size)
    cycles = brake_cycles(dq, max_dv)
    sent = np.array([brake_increment(dq, cycles, step) for step in range(cycles + 3)])
    assert np.all(np.abs(np.diff(sent, axis=0)) <= max_dv * (1 + 1e-6))
    assert np.all(sent[cycles:] == 0.0)


@given(increments)
def test_one_cycle_less_would_exceed_some_deceleration(dq):
    max_dv = np.linspace(0.0005, 0.002, dq.size)
    cycles = brake_cycles(dq, max_dv)
    if cycles > 1:
        assert np.any(np.abs(dq) / (cycles - 1) > max_dv * (1 - 1e-6))


@given(increments, st.integers(0, 40))
def test_travel_is_the_sum_of_the_increments_still_to_come(dq, step):
    cycles = brake_cycles(dq, np.full(dq.size, 0.001))
    to_come = sum((brake_increment(dq, cycles, k) for k in range(step + 1, cycles + 1)), np.zeros(dq.size))
    np.testing.assert_allclose(brake_travel(dq, cycles, step), to_come, atol=1e-12)


@given(increments)
def test_the_brake_is_a_straight_line(dq):
    cycles = brake_cycles(dq, np.full(dq.size, 0.001))
    for step in range(cycles):
        share = (cycles - step) / cycles
        np.testing.assert_array_equal(brake_increment(dq, cycles, step), dq * share)
