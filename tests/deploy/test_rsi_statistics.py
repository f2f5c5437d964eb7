"""What `deltaq krc` says of a KRC, from times and datagrams alone, and what it answers."""

import numpy as np
import pytest
from krc_bench import Bench

from deltaq_deploy.rsi.listen import WireStatistics, ZeroEcho, look_at

KRC = "192.168.10.20:1025"


def telegrams(count: int, krc: str = "krc4", **settings: object) -> list[bytes]:
    bench = Bench(krc=krc, **settings)
    sent = []
    for _ in range(count):
        datagram = bench.krc.tick()
        assert datagram is not None
        sent.append(datagram)
    return sent


def watched(
    datagrams: list[bytes],
    cycle_s: float = 0.012,
    expected: tuple[str, ...] | None = None,
    expected_cycle_s: float | None = None,
) -> WireStatistics:
    statistics = WireStatistics(expected, expected_cycle_s)
    for number, datagram in enumerate(datagrams):
        statistics.saw(number * cycle_s, datagram, KRC)
    return statistics


def test_a_healthy_krc_is_described_and_has_no_problem() -> None:
    seen = watched(telegrams(101)).summary()
    assert (seen.telegrams, seen.garbled, seen.late, seen.ipoc_jumps) == (101, 0, 0, 0)
    assert seen.rate_hz == pytest.approx(1 / 0.012)
    assert seen.cycle is not None
    assert seen.cycle.median_s == pytest.approx(0.012)
    assert (seen.ipoc_step, seen.decimals, seen.peers) == (12, 6, {KRC: 101})
    assert "IPOC counts ms" in seen.guess
    assert "KR C4 with #IPO" in seen.guess
    assert seen.problems == ()


def test_the_delay_of_an_unanswered_krc_grows() -> None:
    seen = watched(telegrams(51, count_from="first_reply")).summary()
    assert (seen.delay, seen.delay_growth) == (50, 50)


def test_an_ipoc_beyond_32_bit_is_a_problem_and_gets_no_reply() -> None:
    own = [datagram.replace(b"<IPOC>", b"<IPOC>12") for datagram in telegrams(3)]
    assert any("IPOC is 12" in problem and "32 bit" in problem for problem in watched(own).summary().problems)
    zeros = ZeroEcho(Bench().pc)
    assert [zeros.answer(datagram, KRC) for datagram in own] == [None] * 3
    assert list(zeros.refusals) == ["IPOC has more than 32 bit, and a KRC's is at most 4294967295"]


def test_a_kr_c2_is_recognised_by_its_first_telegram() -> None:
    seen = watched(telegrams(5, krc="krc2")).summary()
    assert seen.opened_with_ipoc_only
    assert seen.guess.startswith("a KR C2")
    assert "AIPos.A1" in seen.elements


def test_the_slow_and_the_fast_cycle_are_distinguished() -> None:
    seen = watched(telegrams(20, cycle_s=0.004), 0.004).summary()
    assert "#IPO_FAST" in seen.guess
    assert seen.ipoc_step == 4


def test_an_ipoc_that_counts_cycles_is_recognised() -> None:
    rows = [b'<Rob Type="KUKA"><Delay D="0"/><IPOC>%d</IPOC></Rob>' % n for n in range(10)]
    seen = watched(rows).summary()
    assert seen.ipoc_step == 1
    assert "IPOC counts cycles" in seen.guess
    assert seen.problems == ()


def test_a_wrapping_ipoc_is_no_jump() -> None:
    ipocs = [(2**32 - 30 + 12 * n) % 2**32 for n in range(8)]
    assert watched([b'<Rob Type="KUKA"><IPOC>%d</IPOC></Rob>' % n for n in ipocs]).summary().ipoc_jumps == 0


def test_lost_telegrams_count_as_jumps_and_late_intervals() -> None:
    sent = telegrams(30)
    statistics = WireStatistics()
    for number, datagram in enumerate(sent):
        if number not in (10, 20):
            statistics.saw(number * 0.012, datagram, KRC)
    seen = statistics.summary()
    assert (seen.ipoc_jumps, seen.late) == (2, 2)
    assert seen.cycle is not None
    assert seen.cycle.longest_s == pytest.approx(0.024)
    assert any("IPOC jumped 2 times" in problem for problem in seen.problems)


def test_a_second_krc_and_other_senders_are_problems() -> None:
    statistics = watched(telegrams(5))
    statistics.saw(1.0, b"hello", "192.168.10.30:9")
    seen = statistics.summary()
    assert seen.garbled == 1
    assert seen.peers == {KRC: 5, "192.168.10.30:9": 1}
    assert any("2 senders" in problem for problem in seen.problems)
    assert any("1 datagrams are no telegrams" in problem for problem in seen.problems)


def test_one_decimal_is_a_problem() -> None:
    seen = watched(telegrams(5, precision=1)).summary()
    assert seen.decimals == 1
    assert any("Precision" in problem for problem in seen.problems)


def test_another_cycle_than_the_cells_is_a_problem() -> None:
    (problem,) = watched(telegrams(9), 0.012, expected_cycle_s=0.004).summary().problems
    assert problem.startswith("the cycle is 12.00 ms, the cell's 4 ms")


def test_unlisted_and_missing_elements_are_named() -> None:
    sent = telegrams(3)
    listed = watched(sent).summary().elements
    assert watched(sent, expected=listed).summary().problems == ()
    (missing,) = watched(sent, expected=(*listed, "MACur.A1")).summary().problems
    assert missing.startswith("does not send MACur.A1")
    (extra,) = watched(sent, expected=listed[:-1]).summary().problems
    assert extra.startswith(f"sends {listed[-1]}")
    (order,) = watched(sent, expected=listed[::-1]).summary().problems
    assert "another order" in order


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        b"<Rob>",
        b'<Rob Type="KUKA"></Rob>',
        b'<Sen Type="ImFree"><IPOC>1</IPOC></Sen>',
        b"\xff" * 300,
        b'<Rob Type="KUKA"><IPOC>1</IPOC>' + b" " * 5000,
        b'<Rob Type="KUKA"><IPOC>123456789012345678901</IPOC></Rob>',
    ],
)
def test_an_invalid_telegram_is_counted_and_sniffing_continues(datagram: bytes) -> None:
    assert look_at(datagram) is None
    statistics = watched([datagram, *telegrams(2)])
    assert (statistics.summary().garbled, statistics.summary().telegrams) == (1, 2)


def test_silence_gives_a_summary() -> None:
    seen = WireStatistics(("AIPos.A1",), 0.012).summary()
    assert (seen.telegrams, seen.rate_hz, seen.cycle, seen.peers) == (0, None, None, {})
    assert seen.problems == ()


# --- the answers ----------------------------------------------------------------------------------------------


def test_the_echo_answers_with_zeros_and_the_robot_stays() -> None:
    bench = Bench(krc="krc2", q_start=np.full(6, 0.1), late_budget=2, count_from="start")
    echo = ZeroEcho(bench.pc)
    for _ in range(50):
        datagram = bench.krc.tick()
        assert datagram is not None, bench.krc.message
        reply = echo.answer(datagram, KRC)
        assert reply is not None
        assert not bench.krc._codec.decode(reply).correction.any()
        bench.krc.receive(reply)
    assert bench.krc.sample.q == pytest.approx(np.full(6, 0.1))
    assert bench.krc.sample.counters["accepted"] == 49
    assert echo.refusals == {}


def test_an_already_corrected_robot_gets_no_reply() -> None:
    bench = Bench()
    for number in range(40):
        bench.cycle(min(0.001 * number, 0.03))
    echo = ZeroEcho(bench.pc)
    datagram = bench.krc.tick()
    assert datagram is not None
    assert echo.answer(datagram, KRC) is None
    (reason,) = echo.refusals
    assert "stands away from where RSI was started" in reason
    assert bench.krc.sample.q == pytest.approx(np.full(6, 0.03), abs=1e-3)


def test_a_telegram_without_the_programmed_position_gets_no_reply() -> None:
    bench = Bench()
    datagram = bench.krc.tick()
    assert datagram is not None
    telegram = bench.pc.decode(datagram)._replace(q_programmed=None)

    class Without:
        axes, joints = bench.pc.axes, bench.pc.joints
        encode = staticmethod(bench.pc.encode)

        def decode(self, _: bytes):  # type: ignore[no-untyped-def] # as the codec's
            return telegram

    echo = ZeroEcho(Without())  # type: ignore[arg-type] # a codec whose file lacks DEF_ASPos
    assert echo.answer(datagram, KRC) is None
    assert "DEF_ASPos" in next(iter(echo.refusals))


def test_only_the_first_sender_gets_replies_and_garbage_gets_none() -> None:
    bench = Bench()
    echo = ZeroEcho(bench.pc)
    datagram = bench.krc.tick()
    assert datagram is not None
    assert echo.answer(datagram, KRC) is not None
    assert echo.answer(datagram, "192.168.10.30:9") is None
    assert echo.answer(b"<Rob", KRC) is None
    assert sum(echo.refusals.values()) == 2
    for number in range(100):
        echo.answer(datagram, f"192.168.10.30:{number}")
    assert len(echo.refusals) <= 16
