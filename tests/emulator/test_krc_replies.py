import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from krc_bench import Bench

from deltaq_emulator.replies import HISTORY, MAX_EXCUSED
from deltaq_emulator.states import KrcState


def test_a_valid_reply_is_accepted_and_moves_the_robot(bench: Bench) -> None:
    for _ in range(5):
        bench.cycle(0.001)
    bench.cycle(0.001)
    assert bench.krc.sample.counters["accepted"] == 5
    assert bench.krc.sample.q_setpoint == pytest.approx([0.001] * 6, abs=1e-8)
    assert bench.krc.sample.counters["unanswered"] == 0


def test_a_cycle_without_any_reply_is_missing_and_makes_the_delay_grow(bench: Bench) -> None:
    bench.cycle()
    bench.silent(4)
    assert bench.cycle().delay == 4
    assert bench.krc.sample.counters["missing"] == 4
    assert bench.krc.sample.counters["unanswered"] == 4


def test_a_reply_that_comes_a_cycle_too_late_is_counted_late_and_ignored(bench: Bench) -> None:
    bench.cycle()
    first = bench.pc.decode(bench.silent() or b"").ipoc
    bench.krc.tick()
    bench.krc.receive(bench.reply(first, 0.5))
    assert bench.count("late") == 1
    assert not bench.krc.sample.q_setpoint.any()
    assert bench.krc.sample.counters["missing"] == 1
    assert bench.krc.sample.counters["unanswered"] == 2


def test_a_kr_c2_takes_no_reply_in_the_last_part_of_its_cycle() -> None:
    bench = Bench(krc="krc2")
    for age_s, late in ((0.0104, 0), (0.0106, 1)):
        ipoc = bench.pc.decode(bench.krc.tick() or b"").ipoc
        bench.krc.receive(bench.reply(ipoc), age_s)
        assert bench.krc._judge.counts["late"] == late


def test_a_second_reply_to_the_same_telegram_is_a_duplicate_and_the_first_one_counts(bench: Bench) -> None:
    bench.cycle()
    telegram = bench.cycle(0.001)
    bench.krc.receive(bench.reply(telegram.ipoc, 0.002))
    assert bench.count("duplicate") == 1
    assert bench.krc.sample.q_setpoint == pytest.approx([0.001] * 6, abs=1e-8)
    bench.krc.receive(bench.reply(telegram.ipoc, 0.002))
    assert bench.count("duplicate") == 2


def test_a_reply_to_an_unsent_telegram_is_stale(bench: Bench) -> None:
    telegram = bench.cycle()
    bench.krc.tick()
    bench.krc.receive(bench.reply(telegram.ipoc - 12 * (HISTORY + 5), 0.5))
    bench.krc.receive(bench.reply(telegram.ipoc + 5, 0.5))
    assert bench.count("stale") == 2
    assert not bench.krc.sample.q_setpoint.any()


def test_a_time_stamp_ahead_of_the_controller_is_future(bench: Bench) -> None:
    telegram = bench.cycle()
    bench.krc.receive(bench.reply(telegram.ipoc + 12, 0.5))
    assert bench.count("future") == 1


def test_garbage_is_counted_and_the_session_continues(bench: Bench) -> None:
    telegram = bench.cycle()
    for datagram in (b"", b"\xff", b"<Sen/>", bench.reply(telegram.ipoc).replace(b"0.0", b"nan")):
        bench.krc.receive(datagram)
    assert bench.count("garbled") == 4
    bench.cycle(0.001)
    assert bench.krc.state is KrcState.RSI_RUNNING


def test_the_wrong_type_is_counted_and_its_values_are_ignored(bench: Bench) -> None:
    bench.cycle()
    ipoc = bench.pc.decode(bench.krc.tick() or b"").ipoc
    bench.krc.receive(bench.reply(ipoc, 0.5).replace(b"ImFree", b"imfree"))
    assert bench.count("wrong_type") == 1
    assert not bench.krc.sample.q_setpoint.any()
    assert bench.krc.sample.counters["missing"] == 0
    assert bench.krc.sample.counters["unanswered"] == 1


def test_the_time_stamp_wraps_at_32_bit_and_late_stays_late() -> None:
    bench = Bench(ipoc_start=2**32 - 30)
    ipocs = [bench.cycle(0.0).ipoc for _ in range(5)]
    assert ipocs == [2**32 - 30, 2**32 - 18, 2**32 - 6, 6, 18]
    bench.krc.tick()
    assert bench.krc.sample.counters["accepted"] == 5
    bench.krc.receive(bench.reply(2**32 - 18))
    bench.krc.receive(bench.reply(2**32 - 4000))
    bench.krc.receive(bench.reply(100_000))
    counters = {name: bench.krc._judge.counts[name] for name in ("duplicate", "stale", "future")}
    assert counters == {"duplicate": 1, "stale": 1, "future": 1}


@pytest.mark.parametrize(("cycle_s", "step"), [(0.004, 4), (0.012, 12)])
def test_the_time_stamp_steps_by_the_cycle_in_milliseconds(cycle_s: float, step: int) -> None:
    bench = Bench(cycle_s=cycle_s)
    assert np.diff([bench.cycle().ipoc for _ in range(4)]).tolist() == [step] * 3


@pytest.mark.parametrize(
    ("setting", "cell", "step"),
    [(None, None, 12), (1, None, 1), (None, 1, 1), (1, 12, 1), ("ms", 1, 12), (7, None, 7)],
)
def test_the_step_of_the_time_stamp_comes_from_the_settings_or_the_cell(
    setting: int | str | None, cell: int | None, step: int
) -> None:
    bench = Bench(ipoc_step=setting, driver={"ipoc_step": cell})
    assert np.diff([bench.cycle().ipoc for _ in range(4)]).tolist() == [step] * 3
    bench.krc.tick()
    assert bench.krc.sample.counters["accepted"] == 4


def test_a_cycle_counting_time_stamp_wraps_at_32_bit_and_distinguishes_late_from_future() -> None:
    bench = Bench(ipoc_step=1, ipoc_start=2**32 - 2)
    assert [bench.cycle().ipoc for _ in range(4)] == [2**32 - 2, 2**32 - 1, 0, 1]
    bench.silent(2)
    bench.krc.receive(bench.reply(2))
    bench.krc.receive(bench.reply(4))
    counts = {name: bench.krc._judge.counts[name] for name in ("accepted", "late", "future")}
    assert counts == {"accepted": 4, "late": 1, "future": 1}


def test_one_cycle_more_than_the_budget_stops_rsi_with_kss29002() -> None:
    bench = Bench(late_budget=3)
    bench.cycle()
    assert bench.silent(4) is not None
    assert bench.silent() is None
    assert bench.krc.state is KrcState.STOPPED
    assert bench.krc.sample.message == "KSS29002: RSI: 4 cycles without a valid reply, 3 are permitted"
    assert bench.silent(3) is None


@pytest.mark.parametrize(("late_count", "stops"), [("consecutive", False), ("total", True)])
def test_the_budget_counts_consecutive_cycles_or_all_of_them(late_count: str, stops: bool) -> None:
    bench = Bench(late_budget=3, late_count=late_count)
    for _ in range(4):
        bench.cycle()
        if bench.krc.state is KrcState.RSI_RUNNING:
            bench.silent(1)
    bench.silent(1)
    assert (bench.krc.state is KrcState.STOPPED) is stops


@pytest.mark.parametrize(("count_from", "stops"), [("first_reply", False), ("start", True)])
def test_the_budget_counts_from_the_first_reply_or_from_the_start(count_from: str, stops: bool) -> None:
    bench = Bench(late_budget=3, count_from=count_from)
    bench.silent(20)
    assert (bench.krc.state is KrcState.STOPPED) is stops


@pytest.mark.parametrize(("krc", "message"), [("krc2", "RSI: 1.1 % of the last 1000"), ("krc4", "KSS29002")])
def test_each_generation_has_its_own_budget_unless_the_settings_choose(krc: str, message: str) -> None:
    """A share of one percent, or three in a row: what is lost one by one is too much for the former only."""
    bench = Bench(krc=krc, late_budget=3, late_percent=1)
    for _ in range(10):
        bench.cycle()
        bench.silent()
    assert bench.krc.state is KrcState.RSI_RUNNING
    bench.silent(2)
    assert (bench.krc.state is KrcState.STOPPED) is (krc == "krc2")
    bench.silent(5)
    assert bench.krc.sample.message is not None
    assert bench.krc.sample.message.startswith(message)


@pytest.mark.parametrize("krc", ["krc2", "krc4"])
def test_a_reply_missing_by_a_stall_of_the_controller_does_not_count_against_the_pc(
    krc: str,
) -> None:
    bench = Bench(krc=krc, late_budget=3, late_percent=0.3)
    bench.cycle()
    for _ in range(20):
        bench.krc.tick(excused=True)
    assert bench.krc.state is KrcState.RSI_RUNNING
    counters = bench.krc.sample.counters
    assert (counters["excused"], counters["unanswered"], counters["late_counted"]) == (19, 19, 0)
    assert bench.cycle().delay == 20
    bench.silent(6)
    assert bench.krc.state is KrcState.STOPPED


def test_a_long_silent_pc_is_late_despite_stalls_of_the_controller() -> None:
    bench = Bench(late_budget=3)
    bench.cycle()
    silent = 1
    while bench.krc.tick(excused=True) is not None:
        silent += 1
        assert silent < 1000
    assert silent == 1 + MAX_EXCUSED + 4


@settings(max_examples=50)
@given(
    st.lists(
        st.lists(st.sampled_from(["good", "old", "next", "garbage", "type", "double"]), max_size=4),
        max_size=20,
    )
)
def test_every_datagram_is_counted_in_exactly_one_class(cycles: list[list[str]]) -> None:
    bench = Bench(late_budget=1000)
    ipoc, sent = 0, 0
    for kinds in cycles:
        last, ipoc = ipoc, bench.pc.decode(bench.krc.tick() or b"").ipoc
        for kind in kinds:
            datagram = {
                "good": bench.reply(ipoc),
                "double": bench.reply(ipoc),
                "old": bench.reply(last),
                "next": bench.reply((ipoc + 12) % 2**32),
                "garbage": b"?",
                "type": bench.reply(ipoc).replace(b"ImFree", b"Other"),
            }[kind]
            bench.krc.receive(datagram)
            sent += 1
    bench.krc.tick()
    counters = bench.krc.sample.counters
    classes = ("accepted", "late", "stale", "duplicate", "future", "garbled", "wrong_type")
    assert sum(counters[name] for name in classes) == sent
    assert counters["accepted"] + counters["unanswered"] == len(cycles)
    assert counters["missing"] == sum(not kinds for kinds in cycles)
