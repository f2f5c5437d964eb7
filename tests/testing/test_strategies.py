"""Schedules that hypothesis draws: what they are, and what they shrink to."""

import pytest
from hypothesis import find, given, settings

from deltaq_testing.schedule import ScheduleError, checked, fault
from deltaq_testing.strategies import GRID_S, schedules

NAMES = ["krc_duplicating", "hli_dead", "link_cut", "link_lossy"]
WITHOUT_DATABASE = settings(database=None, max_examples=1000, derandomize=True)


@given(schedules(within_s=2.0, most=5, longest_s=0.5))
def test_drawn_faults_can_be_injected_and_end_in_time(faults):
    assert checked(faults) == faults
    assert all(
        timed.at_s >= 0 and timed.end_s <= 2.0 + 1e-9 and timed.for_s <= 0.5 + 1e-9 for timed in faults
    )
    assert len(faults) <= 5


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("cycles", [1, 7, 30])
def test_a_failing_schedule_shrinks_to_one_early_and_short_fault(cycles):
    def fails(faults):
        return any(
            timed.what.name == "controller-hli-cut" and timed.for_s > (cycles - 0.5) * GRID_S
            for timed in faults
        )

    shortest = find(schedules(within_s=2.0, names=NAMES), fails, settings=WITHOUT_DATABASE)
    assert shortest == (fault("link_cut", at_s=0.0, for_s=cycles * GRID_S),)


@pytest.mark.long
@pytest.mark.nightly
def test_two_jointly_needed_faults_are_both_kept():
    def fails(faults):
        return {"hli-dead", "controller-hli-lossy"} <= {timed.what.name for timed in faults}

    shortest = find(schedules(within_s=1.0, names=NAMES), fails, settings=WITHOUT_DATABASE)
    assert {repr(timed) for timed in shortest} == {
        'fault("hli-dead", at_s=0, for_s=0.012)',
        'fault("controller-hli-lossy", at_s=0, for_s=0.012)',
    }


@pytest.mark.parametrize(
    ("bounds", "told"),
    [
        ({"within_s": 1.0, "most": 0}, "most must be 1 or more, got 0"),
        ({"within_s": 0.0}, r"within_s and longest_s must be 0.012 s or more, got 0 and 1"),
        (
            {"within_s": 1.0, "longest_s": 0.001},
            r"within_s and longest_s must be 0.012 s or more, got 1 and 0.001",
        ),
        ({"within_s": 1.0, "names": []}, "names must have at least one fault, got none"),
        ({"within_s": 1.0, "names": ["recorder_dead"]}, "recorder-dead does not exist in virtual time"),
    ],
)
def test_bounds_without_possible_draws_are_refused(bounds, told):
    with pytest.raises(ScheduleError, match=told):
        schedules(**bounds)
