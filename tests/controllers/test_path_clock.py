"""The clock at the other end: how wrong the estimate may be, and how old a view is then."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from told import told_state, told_status

from deltaq_controllers.camera_follower import MOST_CHANGES, Sightings
from deltaq_controllers.robot_clocks import MAX_DRIFT, PathClock, robot_clock_s
from deltaq_protocol.messages import Sight

WAY_S = st.floats(0.0, 0.5)
Ways = list[tuple[float, float]]


@given(
    st.floats(-1e5, 1e5),
    st.floats(-MAX_DRIFT, MAX_DRIFT),
    st.lists(st.tuples(WAY_S, WAY_S), min_size=1, max_size=20),
    st.floats(2.0, 200.0),
)
def test_a_clock_that_drifts_is_known_within_what_is_said_at_any_time(
    offset_s: float, drift: float, ways: Ways, pause_s: float
) -> None:
    clock = PathClock()
    for k, (there_s, back_s) in enumerate(ways):
        asked_s = k * pause_s
        read_s = asked_s + there_s
        clock.take(asked_s, read_s + offset_s + drift * read_s, read_s + back_s)
        now_s = asked_s + pause_s
        assert abs(clock.offset_s - (offset_s + drift * now_s)) <= clock.error_s(now_s) + 1e-9


def test_the_quickest_exchange_is_believed_until_drift_has_made_it_worse_than_a_slower_one() -> None:
    clock = PathClock()
    clock.take(0.0, 5.0, 0.002)
    assert clock.error_s(0.002) == pytest.approx(0.001, abs=1e-6)
    clock.take(10.0, 15.008, 10.006)
    assert (clock.offset_s, clock.error_s(10.002)) == pytest.approx((4.999, 0.002), abs=1e-5)
    clock.take(30.0, 35.008, 30.006)
    assert (clock.offset_s, clock.error_s(30.006)) == pytest.approx((5.005, 0.003), abs=1e-5)


def test_a_clock_that_was_set_is_believed_the_second_time_and_a_late_stamp_never() -> None:
    clock = PathClock()
    clock.take(0.0, 5.0, 0.002)
    clock.take(2.0, 6.5, 2.002)
    clock.take(4.0, 9.0, 4.002)
    assert clock.offset_s == pytest.approx(4.999)
    clock.take(6.0, 106.0, 6.002)
    assert clock.offset_s == pytest.approx(4.999)
    clock.take(8.0, 108.0, 8.002)
    assert clock.offset_s == pytest.approx(99.999)


@given(st.floats(-1e5, 1e5), WAY_S, WAY_S, st.floats(0.0, 2.0))
def test_the_age_of_a_view_is_known_as_well_as_the_clock(
    offset_s: float, there_s: float, back_s: float, age_s: float
) -> None:
    clock, now_s = PathClock(), 7.0
    clock.take(1.0, 1.0 + there_s + offset_s, 1.0 + there_s + back_s)
    assert abs(clock.age_s(now_s - age_s + offset_s, now_s) - age_s) <= clock.error_s(now_s) + 1e-9


def test_before_the_first_exchange_nothing_is_known() -> None:
    clock = PathClock()
    assert (clock.known, clock.offset_s, clock.error_s(0.0)) == (False, 0.0, math.inf)
    assert clock.summary(0.0) == {"offset_s": None, "error_s": None}


def test_a_clock_that_was_set_in_between_is_refused_with_both_times() -> None:
    with pytest.raises(ValueError, match=r"answered_s: 1\.0 is before the request, 2\.0"):
        PathClock().take(2.0, 5.0, 1.0)


def test_the_clock_of_a_robots_server_is_read_off_a_status_by_whole_cycles() -> None:
    status = told_status(fr=(110, 0.004))
    assert robot_clock_s(status, told_state(cycle=100, time_s=50.0), 0.012) == pytest.approx(
        50.0 + 10 * 0.012 + 0.004
    )


def test_of_a_robot_that_the_hli_does_not_know_no_clock_is_read() -> None:
    assert robot_clock_s(told_status(fr=(0, None)), told_state(cycle=1, time_s=5.0), 0.012) is None
    other = told_state(cycle=1, time_s=5.0, robot="gr")
    assert robot_clock_s(told_status(fr=(1, 0.0)), other, 0.012) is None


def test_of_a_robot_server_that_has_begun_to_count_again_no_clock_is_read_by_the_cycles_of_the_one_before() -> (
    None
):
    assert robot_clock_s(told_status(fr=(3, 0.0)), told_state(cycle=100, time_s=50.0), 0.012) is None


def test_sightings_tell_when_a_view_was_stale_lost_and_seen_again_and_forget_the_oldest() -> None:
    sightings = Sightings()
    order = [Sight.FRESH, Sight.FRESH, Sight.STALE, Sight.LOST, Sight.LOST, Sight.FRESH]
    changed = [sightings.add(sight, 0.1 * k, float(k)) for k, sight in enumerate(order)]
    assert changed == [False, False, True, True, False, True]
    told = sightings.summary()
    assert (told["fresh"], told["view_stale"], told["view_lost"]) == (3, 1, 2)
    assert told["changes"][0] == {"time_s": 2.0, "sight": "view_stale", "age_s": pytest.approx(0.2)}
    for k in range(MOST_CHANGES):
        sightings.add((Sight.STALE, Sight.LOST)[k % 2], 0.0, 10.0 + k)
    changes = sightings.summary()["changes"]
    assert (len(changes), changes[0]["time_s"]) == (MOST_CHANGES, 10.0)


def test_a_follower_that_never_sees_the_leader_well_says_so_from_the_first_cycle() -> None:
    assert Sightings().add(Sight.LOST, 0.0, 0.0)
