"""Figures of a live benchmark from stamps: lost ones, late ones, none at all, and what a braked cycle is blamed on."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from stamped import MS, ns, stamp

from deltaq_experiments.bench.hop_reference import HopTimes, machine_time
from deltaq_experiments.bench.journeys import OF_ADMISSION, OF_DECISION, RobotStamps, by_robot, journeys
from deltaq_experiments.bench.live_figures import (
    BrakeCause,
    LiveRow,
    Quantiles,
    bounded_rows,
    causes,
    ratio,
    robot_figures,
)
from deltaq_protocol.stamps import CycleOutcome, StampStation, WrittenStamps


@pytest.fixture
def stamps() -> RobotStamps:
    return RobotStamps()


BRAKED = CycleOutcome.BRAKED


def hop_times(rows: list[list[int]], cycle_s: float = 0.012) -> HopTimes:
    return HopTimes(cycle_s, np.array(rows, dtype=np.int64).reshape(-1, 6))


def even_hops(count: int) -> HopTimes:
    return hop_times([[ns(c), *(ns(c) + hop * 100_000 for hop in range(1, 6))] for c in range(count)])


# --- quantiles ----------------------------------------------------------------------------------------------


def test_without_measurements_there_are_no_quantiles() -> None:
    none = Quantiles.of([])
    assert (none.count, none.p50, none.p99, none.p99_9, none.longest) == (0, None, None, None, None)


def test_quantiles_are_measured_values_by_nearest_rank() -> None:
    thousand = Quantiles.of([float(value) for value in range(1000, 0, -1)])
    assert (thousand.p50, thousand.p99, thousand.p99_9, thousand.longest) == (500.0, 990.0, 999.0, 1000.0)
    one = Quantiles.of([3.0])
    assert (one.p50, one.p99, one.p99_9, one.longest) == (3.0, 3.0, 3.0, 3.0)


@pytest.mark.parametrize(("value", "reference"), [(None, 1.0), (1.0, None), (1.0, 0.0), (1.0, -1.0)])
def test_there_is_no_ratio_to_a_missing_or_zero_reference(
    value: float | None, reference: float | None
) -> None:
    assert ratio(value, reference) is None


# --- journeys -----------------------------------------------------------------------------------------------


def test_without_stamps_there_are_no_journeys_and_no_rate() -> None:
    figures = robot_figures(RobotStamps(), 0, ns(100), even_hops(0))
    assert (figures.cycles, figures.fresh, figures.admission_rate, figures.increments) == (0, 0, None, 0)
    assert figures.longest_client_cycle_ms is None
    assert all(station.age_ms.count == 0 and station.ratio_p50 is None for station in figures.stations)


def test_an_increment_is_joined_through_all_stations(stamps: RobotStamps) -> None:
    stamp(stamps, 4)
    [one] = journeys(stamps, 0, ns(10))
    assert (one.cycle, one.seq, one.decided_on) == (4, 4, 4)
    assert one.age_ns(StampStation.ADMISSION_AT_SERVER) == 9 * MS
    assert set(one.at_ns) == set(StampStation)


@pytest.mark.parametrize("lost", [s for s in StampStation if s is not StampStation.TELEGRAM])
def test_a_lost_stamp_omits_its_station_and_keeps_earlier_ones(lost: StampStation) -> None:
    stamps = RobotStamps()
    stamp(stamps, 4, without=(lost,))
    stamp(stamps, 5)
    figures = robot_figures(stamps, 0, ns(10), even_hops(10))
    missing = {station.station: station.missing for station in figures.stations}
    assert figures.increments == 2
    assert max(missing.values()) == 1
    if lost in (
        StampStation.REQUEST_AT_GATE,
        StampStation.DECISION_BEGUN,
    ):  # what joins an increment with its decision
        assert missing["decided"] == missing["admission at the Robot Server"] == 1
    else:
        assert sum(missing.values()) == 1


def test_an_increment_whose_telegram_has_no_stamp_is_left_out(stamps: RobotStamps) -> None:
    stamp(stamps, 4, without=(StampStation.TELEGRAM,))
    assert journeys(stamps, 0, ns(10)) == []


def test_an_increment_decided_one_cycle_later_takes_that_cycles_admission(stamps: RobotStamps) -> None:
    stamp(
        stamps, 4, decided_on=5, later_ms={s: 8.0 for s in StampStation if s >= StampStation.DECISION_BEGUN}
    )
    [one] = journeys(stamps, 0, ns(10))
    assert one.decided_on == 5
    assert one.age_ns(StampStation.ADMISSION_AT_SERVER) == 17 * MS


def test_sequence_numbers_of_a_second_lease_are_not_those_of_the_first(stamps: RobotStamps) -> None:
    stamp(stamps, 4, seq=1)
    stamp(stamps, 40, seq=1)
    assert [(one.cycle, one.decided_on) for one in journeys(stamps, 0, ns(100))] == [(4, 4), (40, 40)]


def test_of_two_stamps_of_one_kind_the_first_counts(stamps: RobotStamps) -> None:
    stamp(stamps, 4)
    stamps.add(StampStation.TELEGRAM, 4, 0, ns(4) + 5 * MS)
    assert journeys(stamps, 0, ns(10))[0].age_ns(StampStation.DECIDED) == 7 * MS


def test_only_cycles_of_the_window_count(stamps: RobotStamps) -> None:
    for cycle in range(10):
        stamp(stamps, cycle)
    figures = robot_figures(stamps, ns(3), ns(7), even_hops(10))
    assert (figures.cycles, figures.increments, figures.admission_rate) == (4, 4, 1.0)


def test_stamps_of_all_processes_are_sorted_by_robot() -> None:
    def written(process: str, robots: tuple[str, ...], rows: list[list[int]]) -> WrittenStamps:
        return WrittenStamps(process, robots, 0, np.array(rows, dtype=np.int64).reshape(-1, 5))

    found = by_robot(
        [
            written("robot-server-gr", ("gr",), [[StampStation.TELEGRAM, 0, 7, 0, 100]]),
            written("sim", ("fr", "gr"), [[StampStation.ADMISSION_OUT, 1, 7, 0, 200]]),
            written("hli", ("fr", "gr"), []),
        ]
    )
    assert set(found) == {"gr"}
    assert found["gr"].of_cycle[StampStation.TELEGRAM] == {7: 100}
    assert found["gr"].of_cycle[StampStation.ADMISSION_OUT] == {7: 200}


# --- braked cycles ------------------------------------------------------------------------------------------

LATE_MS = 12.5


@pytest.mark.parametrize(
    ("before", "cause"),
    [
        (
            {"without": tuple(s for s in StampStation if s >= StampStation.STATE_AT_CLIENT)},
            BrakeCause.STATE_MISSED,
        ),
        (
            {"without": tuple(s for s in StampStation if s >= StampStation.INCREMENT_OUT)},
            BrakeCause.NO_INCREMENT,
        ),
        (
            {
                "without": tuple(s for s in StampStation if s >= StampStation.INCREMENT_AT_HLI),
                "later_ms": {StampStation.INCREMENT_OUT: LATE_MS},
            },
            BrakeCause.CLIENT_LATE,
        ),
        (
            {"without": tuple(s for s in StampStation if s >= StampStation.INCREMENT_AT_HLI)},
            BrakeCause.ON_WAY_TO_HLI,
        ),
        (
            {"without": tuple(s for s in StampStation if s >= StampStation.REQUEST_AT_GATE)},
            BrakeCause.ON_WAY_TO_GATE,
        ),
        (
            {"without": tuple(s for s in StampStation if s >= StampStation.DECISION_BEGUN)},
            BrakeCause.NOT_DECIDED,
        ),
        ({"without": (StampStation.ADMISSION_OUT, StampStation.ADMISSION_AT_SERVER)}, BrakeCause.GATE_HELD),
        ({"without": (StampStation.ADMISSION_AT_SERVER,)}, BrakeCause.ADMISSION_LOST),
        ({"later_ms": {StampStation.ADMISSION_AT_SERVER: LATE_MS}}, BrakeCause.ADMISSION_LATE),
        (
            {"later_ms": {s: LATE_MS for s in StampStation if s >= StampStation.DECIDED}},
            BrakeCause.GATE_LATE,
        ),
        ({}, BrakeCause.ADMISSION_REFUSED),
    ],
)
def test_a_braked_cycle_is_blamed_on_the_first_station_not_passed_in_time(
    before: dict[str, object], cause: BrakeCause
) -> None:
    stamps = RobotStamps()
    stamp(stamps, 4, **before)  # type: ignore[arg-type] # the cases above
    # the gate does one thing after the other: it has not begun with the next one before it is done with this one
    stamp(stamps, 5, outcome=BRAKED, without=OF_DECISION + OF_ADMISSION)
    assert causes(stamps, [5]) == Counter({cause: 1})


def ahead_stamps(
    last: int, braked: tuple[int, ...] = (), **of: dict[str, object]
) -> tuple[RobotStamps, list[int]]:
    """A robot in a cell with a lookahead of 2 whose increments go two cycles ahead; `of` cycles other stamps are taken.

    Returns:
        The stamps, and the cycles that have an outcome.
    """
    stamps = RobotStamps()
    for cycle in range(last + 1):
        outcome = BRAKED if cycle in braked else CycleOutcome.FRESH
        usual: dict[str, object] = {"setpoint_cycle": cycle + 2, "outcome": outcome}
        stamp(stamps, cycle, **usual | of.get(f"c{cycle}", {}))  # type: ignore[arg-type] # as `stamp` takes them
    return stamps, list(range(last + 1))


def test_with_a_lookahead_an_increment_in_a_later_setpoint_counts_as_late() -> None:
    """That of cycle 5 comes after the telegram of 7, where its setpoint is sent, and goes into that of 8."""
    late = {station: 18.0 for station in StampStation if station >= StampStation.REQUEST_AT_GATE}
    stamps, cycles = ahead_stamps(
        8,
        braked=(7,),
        c5={"later_ms": late | {StampStation.REQUEST_AT_GATE: 20.0}, "decided_on": 6, "setpoint_cycle": 8},
        c6={"later_ms": late, "decided_on": 7, "setpoint_cycle": 9},
        c7={"later_ms": late, "decided_on": 8, "setpoint_cycle": 10},
    )
    assert causes(stamps, cycles, lookahead_cycles=2) == Counter({BrakeCause.ON_WAY_TO_GATE: 1})


def test_with_a_lookahead_a_late_increment_counts_only_for_its_missed_setpoint() -> None:
    """Increments are decided a cycle late from cycle 5 on, and none of them too late."""
    late = {station: 8.0 for station in StampStation if station >= StampStation.INCREMENT_OUT}
    stamps, cycles = ahead_stamps(8, **{f"c{cycle}": {"later_ms": late} for cycle in (5, 6, 7, 8)})
    assert causes(stamps, cycles, lookahead_cycles=2) == Counter()


def test_with_a_lookahead_an_increment_in_an_earlier_setpoint_does_not_count_as_held() -> None:
    """The answer to 3 is missing, and those behind it move up; 7 is without one when the answer to 6 is missing too."""
    none = {"without": tuple(s for s in StampStation if s >= StampStation.INCREMENT_OUT)}
    stamps, cycles = ahead_stamps(
        8,
        braked=(7,),
        c3=none,
        c4={"setpoint_cycle": 5},
        c5={"setpoint_cycle": 6},
        c6=none,
        c7={"setpoint_cycle": 8},
        c8={"setpoint_cycle": 9},
    )
    assert causes(stamps, cycles, lookahead_cycles=2) == Counter({BrakeCause.NO_INCREMENT: 1})


def test_with_a_lookahead_held_increments_count_as_held() -> None:
    held = {"without": OF_ADMISSION}
    stamps, cycles = ahead_stamps(8, braked=(7,), c5=held)
    assert causes(stamps, cycles, lookahead_cycles=2) == Counter({BrakeCause.GATE_HELD: 1})


def test_admissions_after_a_break_of_the_chain_are_reported() -> None:
    """The admission for 6 is lost; that for 7 follows it and is refused, and the next one goes into 8."""
    lost = {"without": (StampStation.ADMISSION_AT_SERVER,)}
    stamps, cycles = ahead_stamps(8, braked=(6, 7), c4=lost)
    expected = Counter({BrakeCause.ADMISSION_LOST: 1, BrakeCause.CHAIN_BROKE: 1})
    assert causes(stamps, cycles, lookahead_cycles=2) == expected


def test_a_held_robot_and_a_missed_reply_are_causes_of_their_own(stamps: RobotStamps) -> None:
    stamp(stamps, 4, outcome=CycleOutcome.HELD)
    stamp(stamps, 5, outcome=CycleOutcome.REPLY_MISSED)
    stamp(stamps, 6)
    assert causes(stamps, [4, 5, 6, 7]) == Counter({BrakeCause.HELD: 1, BrakeCause.REPLY_MISSED: 1})


def test_every_braked_cycle_has_one_cause(stamps: RobotStamps) -> None:
    for cycle in range(20):
        lost = (StampStation.ADMISSION_AT_SERVER,) if cycle % 3 == 1 else ()
        stamp(stamps, cycle, without=lost, outcome=BRAKED if cycle % 3 == 2 else CycleOutcome.FRESH)
    figures = robot_figures(stamps, 0, ns(20), even_hops(20))
    assert (figures.cycles, figures.fresh) == (20, 14)
    assert figures.braked == {BrakeCause.ADMISSION_LOST.value: 6}


# --- beside the reference -----------------------------------------------------------------------------------


def test_ages_are_compared_with_the_same_number_of_hops(stamps: RobotStamps) -> None:
    for cycle in range(10):
        stamp(stamps, cycle)
    figures = robot_figures(stamps, 0, ns(10), even_hops(10))
    by_name = {station.station: station for station in figures.stations}
    assert by_name["state out"].ratio_p50 is None
    assert by_name["request at the gate"].ratio_p50 == pytest.approx(5.0 / 0.4)
    assert by_name["admission at the Robot Server"].ratio_p99 == pytest.approx(9.0 / 0.5)
    assert figures.longest_client_cycle_ms == pytest.approx(12.0)


def test_the_reference_counts_its_own_misses() -> None:
    late, lost = [0, 1, 2, 3, 4, ns(1)], [ns(1), 0, 0, 0, 0, 0]
    times = hop_times([late, lost, [ns(2), *(ns(2) + hop for hop in range(1, 6))]])
    assert times.in_time == pytest.approx(1 / 3)
    assert times.ages_s(5) == pytest.approx([0.012, 5e-9])
    assert times.longest_client_cycle_s == pytest.approx(0.024)
    assert hop_times([]).in_time == 0.0
    assert hop_times([]).longest_client_cycle_s is None


@pytest.mark.parametrize(("cycle_s", "at_least", "at_most"), [(0.012, 99.9, 24.0), (0.004, 99.5, None)])
def test_bounds_depend_on_the_cycle(cycle_s: float, at_least: float, at_most: float | None) -> None:
    stamps = RobotStamps()
    stamp(stamps, 4)
    times = hop_times([[0, 1, 2, 3, 4, 5]], cycle_s)
    robots = {"fr": robot_figures(stamps, 0, ns(10), times)}
    rate, longest, processor, stolen = bounded_rows(robots, {"sim": 300.0, "hli": 100.0}, times, 4.0, 0.25)
    assert (rate.at_least, longest.at_most) == (at_least, at_most)
    assert (rate.value, rate.kept) == (100.0, True)
    assert longest.value is None
    assert longest.kept is (False if at_most else None)
    assert (processor.value, processor.ratio, processor.kept) == (400.0, 100.0, None)
    assert (stolen.value, stolen.kept) == (25.0, None)


def test_stolen_time_is_reported_for_the_window_alone(tmp_path: Path) -> None:
    stat = tmp_path / "stat"
    times = []
    for user, idle, stolen in ((100, 900, 50), (130, 920, 100)):
        stat.write_text(
            f"cpu  {user} 0 0 {idle} 0 0 0 {stolen} 7 7\ncpu0 1 1 1 1 1 1 1 1 1 1\n", encoding="ascii"
        )
        times.append(machine_time(stat))
    before, after = times
    assert after.stolen_share_since(before) == pytest.approx(0.5)
    assert before.stolen_share_since(before) is None


def test_a_narrowly_missed_bound_is_missed() -> None:
    assert LiveRow.of("rate", 99.89, "%", 100.0, at_least=99.9).kept is False
    assert LiveRow.of("longest", 24.01, "ms", 12.0, at_most=24.0).kept is False
    assert LiveRow.of("rate", None, "%", 100.0, at_least=99.9).kept is False
    assert LiveRow.of("rate", 99.9, "%", 100.0, at_least=99.9).kept is True
    assert LiveRow.of("processor", 1e9, "µs", 1.0).kept is None
