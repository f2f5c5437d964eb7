"""The clock at the other end: how wrong the estimate may be, and how old a view is then."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_controllers.camera.sightings import MOST_CHANGES, Sightings
from deltaq_controllers.path_clock import PathClock, robot_clock_s
from deltaq_protocol.messages import LeaseStatus, Phase, RobotState, RobotStatus, Sight, Status, ToolPose


def told_state(cycle: int, time_s: float) -> RobotState:
    pose = ToolPose(position=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
    joints = {"q": (0.0,), "q_cmd": (0.0,)}
    return RobotState(robot="fr", cycle=cycle, ipoc=0, time_s=time_s, tool=pose, phase=Phase.READY, **joints)


def told_status(cycle: int, state_age_s: float | None) -> Status:
    lease = LeaseStatus(holder=None, expires_s=None, epoch=0)
    robot = RobotStatus(
        phase=Phase.READY, reason=None, cycle=cycle, state_age_s=state_age_s, q=(), lease=lease, counters={}
    )
    return Status(cell="lab", robots={"fr": robot}, gate={}, gate_age_s=None, hli={})


WAY_S = st.floats(0.0, 0.5)


@given(st.floats(-1e5, 1e5), st.lists(st.tuples(st.floats(0.0, 1e4), WAY_S, WAY_S), min_size=1, max_size=20))
def test_the_offset_is_wrong_by_half_the_asymmetry_of_the_quickest_exchange(
    offset_s: float, exchanges: list[tuple[float, float, float]]
) -> None:
    clock = PathClock()
    for asked_s, there_s, back_s in exchanges:
        clock.take(asked_s, asked_s + there_s + offset_s, asked_s + there_s + back_s)
    quickest_s = min(there_s + back_s for _, there_s, back_s in exchanges)
    asymmetries = [
        abs(there_s - back_s) / 2.0
        for _, there_s, back_s in exchanges
        if there_s + back_s <= quickest_s + 1e-9
    ]
    error_s = abs(clock.offset_s - offset_s)
    assert error_s <= max(asymmetries) + 1e-9
    assert error_s <= clock.error_s + 1e-9
    assert clock.error_s == pytest.approx(quickest_s / 2.0, abs=1e-9)


@given(st.floats(-1e5, 1e5), WAY_S, WAY_S, st.floats(0.0, 2.0))
def test_the_age_of_a_view_is_known_as_well_as_the_clock(
    offset_s: float, there_s: float, back_s: float, age_s: float
) -> None:
    clock, now_s = PathClock(), 7.0
    clock.take(1.0, 1.0 + there_s + offset_s, 1.0 + there_s + back_s)
    assert abs(clock.age_s(now_s - age_s + offset_s, now_s) - age_s) <= clock.error_s + 1e-9


def test_before_the_first_exchange_nothing_is_known() -> None:
    assert (PathClock().offset_s, PathClock().error_s) == (0.0, math.inf)


def test_a_clock_that_was_set_in_between_is_refused_with_both_times() -> None:
    with pytest.raises(ValueError, match=r"answered_s: 1\.0 is before the request, 2\.0"):
        PathClock().take(2.0, 5.0, 1.0)


def test_the_clock_of_a_robots_server_is_read_off_a_status_by_whole_cycles() -> None:
    status = told_status(cycle=110, state_age_s=0.004)
    assert robot_clock_s(status, told_state(cycle=100, time_s=50.0), 0.012) == pytest.approx(
        50.0 + 10 * 0.012 + 0.004
    )
    assert robot_clock_s(status, told_state(cycle=111, time_s=50.012), 0.012) == pytest.approx(50.0 + 0.004)


def test_of_a_robot_that_the_hli_does_not_know_no_clock_is_read() -> None:
    assert (
        robot_clock_s(told_status(cycle=0, state_age_s=None), told_state(cycle=1, time_s=5.0), 0.012) is None
    )
    other = told_state(cycle=1, time_s=5.0).model_copy(update={"robot": "gr"})
    assert robot_clock_s(told_status(cycle=1, state_age_s=0.0), other, 0.012) is None


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
