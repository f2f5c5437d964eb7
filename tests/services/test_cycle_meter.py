"""The meter of a KRC's cycle, on times that a test makes: what is another cycle, and what is a busy machine."""

import random

import pytest
from remembered import remembered

from deltaq_services.robot_server.cycle_meter import DRIFT, SLOW_WINDOWS, WINDOW_TICKS, CycleMeter

SILENCE_S = 0.25


def metered(cycle_s, step, times, given=None, ticks=1):
    """A meter that was handed telegrams at these times, each so many ticks after the one before."""
    meter = CycleMeter(cycle_s, SILENCE_S, given)
    first, *others = times
    meter.begin(step, first)
    for time_s in others:
        meter.tick(ticks, time_s)
    return meter


def every(period_s, duration_s):
    return [5.0 + number * period_s for number in range(round(duration_s / period_s) + 1)]


@pytest.mark.parametrize(
    ("cycle_s", "step", "period_s", "told"),
    [
        (0.012, 4, 0.004, "ticks every 4.0 ms by its IPOC and 4.0 ms by the clock, the cell says 12.0 ms"),
        (0.012, 4, 0.012, "ticks every 4.0 ms by its IPOC and 12.0 ms by the clock"),
        (0.012, 12, 0.004, "ticks every 12.0 ms by its IPOC and 4.0 ms by the clock"),
        (0.012, 1, 0.004, "ticks every 4.0 ms by the clock, the cell says 12.0 ms"),
        (0.012, 1, 0.008, "ticks every 8.0 ms by the clock"),
        (0.004, 12, 0.012, "ticks every 12.0 ms by its IPOC and 12.0 ms by the clock, the cell says 4.0 ms"),
        (0.004, 12, 0.0075, "ticks every 12.0 ms by its IPOC and 7.5 ms by the clock"),
    ],
)
def test_another_cycle_is_a_fault_with_both_figures_and_never_known(cycle_s, step, period_s, told):
    meter = CycleMeter(cycle_s, SILENCE_S, None)
    first, *others = every(period_s, 4.0)
    meter.begin(step, first)
    for time_s in others:
        meter.tick(1, time_s)
        assert not meter.known
    assert told in meter.fault
    assert "#IPO" in meter.fault


@pytest.mark.parametrize(
    ("cycle_s", "step", "period_s"),
    [
        (0.012, 12, 0.012),
        (0.004, 4, 0.004),
        (0.012, 1, 0.012),
        (0.004, 1, 0.004),
        (0.004, 4, 0.0072),  # a busy machine
        (0.012, 12, 0.036),
        (0.004, 1, 0.012),
        (0.012, 12, 0.01196),  # clocks that drift
        (0.004, 12, 0.004),  # another count
    ],
)
def test_the_cells_cycle_a_count_and_a_slow_machine_are_no_fault(cycle_s, step, period_s):
    meter = metered(cycle_s, step, every(period_s, 20.0))
    assert (meter.known, meter.fault) == (True, "")
    assert ("a busy machine?" in meter.detail) == (period_s > 1.3 * cycle_s)


def test_a_faster_ipoc_is_a_fault_with_the_first_telegram_of_a_session():
    meter = CycleMeter(0.012, SILENCE_S, None)
    meter.begin(4, 5.0)
    assert meter.fault.startswith("the KRC ticks every 4.0 ms by its IPOC, the cell says 12.0 ms")
    assert "set driver.ipoc_step to 4" in meter.fault
    meter.begin(12, 6.0)
    assert meter.fault == ""


def test_a_step_that_the_cell_gives_says_nothing_of_time():
    assert metered(0.012, 4, every(0.012, 2.0), given=4).known
    assert "ticks every 4.0 ms by the clock" in metered(0.012, 4, every(0.004, 2.0), given=4).fault


def test_the_cycle_is_known_after_one_window_at_its_pace_and_no_sooner():
    times = every(0.012, 2.0)
    assert not metered(0.012, 12, times[:WINDOW_TICKS]).known
    assert metered(0.012, 12, times[: WINDOW_TICKS + 1]).known
    hurried = [5.0 + number * 0.009 for number in range(WINDOW_TICKS + 1)]
    assert not metered(0.012, 12, hurried).known


def test_a_krc_that_ticks_faster_all_at_once_is_a_fault_before_it_gains_half_a_second():
    meter = metered(0.012, 1, every(0.012, 10.0))
    time_s, gained_s = 15.0 + 0.012, 0.0
    meter.tick(1, time_s)
    while not meter.fault:
        time_s += 0.004
        gained_s += 0.008
        meter.tick(1, time_s)
        assert gained_s < 0.5
    assert not meter.known
    assert "ticks every 4." in meter.fault  # not the mean with what was before
    for _ in range(1000):
        time_s += 0.004
        meter.tick(1, time_s)
    begin_s = time_s
    while meter.fault:  # at its pace again, it is one no longer
        time_s += 0.012
        meter.tick(1, time_s)
        assert time_s < begin_s + 0.5 / DRIFT
    assert meter.known


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
@pytest.mark.parametrize("seed", range(5))
def test_jitter_bursts_and_pauses_are_no_fault(cycle_s, seed):
    draw = random.Random(seed)
    step, stall_s, free_s, times = round(1000 * cycle_s), 0.0, 0.0, []
    for number in range(round(30.0 / cycle_s)):
        sent_s = number * cycle_s
        if draw.random() < 0.02:
            stall_s = sent_s + draw.random() * 0.95 * SILENCE_S
        free_s = max(free_s, stall_s, sent_s + draw.random() * 0.02)  # none overtakes another
        times.append(free_s)
    assert metered(cycle_s, step, times).fault == ""
    assert metered(cycle_s, step, times).known


def test_telegrams_that_were_lost_or_read_together_count_as_the_cycles_that_they_are():
    meter = metered(0.004, 4, every(0.012, 4.0), ticks=3)
    assert (meter.known, meter.fault) == (True, "")
    assert meter.detail == "a telegram every 4.0 ms"


def test_slow_by_ipoc_and_clock_for_a_moment_is_no_fault():
    slow = every(0.012, 0.012 * WINDOW_TICKS * (SLOW_WINDOWS - 1) + 0.1)
    assert metered(0.004, 12, slow).fault == ""
    assert not metered(0.004, 12, slow).known


def test_slow_moments_with_others_between_them_are_no_fault():
    meter, time_s = CycleMeter(0.004, SILENCE_S, None), 5.0
    meter.begin(12, time_s)
    for window in range(4 * SLOW_WINDOWS):
        for _ in range(WINDOW_TICKS):
            time_s += 0.004 if window % 4 == 3 else 0.012
            meter.tick(1, time_s)
        assert meter.fault == ""


def test_a_meter_goes_on_from_the_memory_of_another():
    times = every(0.0078, 0.5)
    one, heir = metered(0.012, 1, times), CycleMeter(0.012, SILENCE_S, None)
    heir.restore(one.snapshot())
    for number in range(200):
        for meter in (one, heir):
            meter.tick(1, times[-1] + (number + 1) * 0.004)
        assert remembered(heir) == remembered(one)
    assert one.fault
