"""Where a robot is once its setpoint rests."""

import numpy as np

from deltaq_services.robot_server.measurement import Settling

TOLERANCE = np.array([0.5, 0.25])
HERE = np.zeros(2)


def rested(cycles):
    settling = Settling(TOLERANCE, lag_cycles=3)
    for _ in range(cycles):
        settling = settling.sent(moves=False)
    return settling


def test_it_is_at_rest_when_the_drives_have_had_the_time_and_no_cycle_before():
    assert [rested(cycles).at_rest for cycles in range(6)] == [False] * 4 + [True] * 2
    assert not rested(9).sent(moves=True).at_rest


def test_how_long_it_has_rested_is_counted_no_further_than_it_matters():
    assert rested(50) == rested(4)


def test_two_places_are_near_up_to_the_tolerance_of_each_joint():
    settling = rested(0)
    assert settling.is_near(HERE, TOLERANCE)
    assert settling.is_near(TOLERANCE, HERE)
    assert not settling.is_near(HERE, np.array([0.0, 0.26]))
    assert not settling.is_near(np.array([-0.51, 0.0]), HERE)


def test_it_goes_on_if_it_leaves_where_it_was_when_its_drives_had_had_the_time():
    before = rested(3).measured(HERE)
    assert before.q_settled is None
    assert not before.goes_on(10 * TOLERANCE)
    settled = rested(4).measured(HERE).measured(TOLERANCE)
    assert settled.q_settled is HERE
    assert not settled.goes_on(TOLERANCE)
    assert settled.goes_on(1.01 * TOLERANCE)
    moved = settled.sent(moves=True).measured(HERE)
    assert moved.q_settled is None
