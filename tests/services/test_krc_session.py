"""Which telegrams a session consists of, at the bounds of what is believed."""

import numpy as np
import pytest
from telegram_storm import Storm

from deltaq_cell.load import load_cell
from deltaq_protocol.rsi import KrcTelegram
from deltaq_services.robot_server.session import (
    AUTOMATON,
    CONFIRMATIONS,
    STILL,
    Answer,
    Belief,
    DatagramSource,
    Peer,
    Plausibility,
    Session,
    TelegramKind,
)

FR = load_cell("lab").robots["fr"]
CYCLE_S = 0.012
SILENCE_S = 20 * CYCLE_S
STEP = 12
BEGIN = 1000
LAST = BEGIN + (CONFIRMATIONS - 1) * STEP
BEHIND = 100
"""Cycles that an overtaken telegram may be behind."""
JITTER = 3
"""Cycles that the IPOC may run ahead of the elapsed time."""


def telegram(ipoc, q=FR.home, programmed=FR.home):
    return KrcTelegram(ipoc % 2**32, q, None, {}, programmed)


def session(ipoc_step=None, silence_s=SILENCE_S, cycle_s=CYCLE_S):
    return Session(cycle_s, silence_s, ipoc_step, Plausibility.of(FR, cycle_s), FR.tracking_tolerance)


def confirm(one, begin_s=0.0, begin=BEGIN, step=STEP, count=CONFIRMATIONS, **fields):
    """Hand it telegrams that agree, one a cycle; returns the kind of each, and believes the confirmed one."""
    kinds = []
    for number in range(count):
        told, time_s = telegram(begin + number * step, **fields), begin_s + number * CYCLE_S
        kinds.append(one.judge(told, time_s).kind)
        if kinds[-1] is TelegramKind.CONFIRMED:
            one.believe(told, time_s)
    return kinds


def begun():
    """A session whose newest telegram has the IPOC `LAST` and came at 0 s."""
    one = session()
    assert confirm(one, begin_s=-(CONFIRMATIONS - 1) * CYCLE_S)[-1] is TelegramKind.CONFIRMED
    assert (one.belief, one.step, one.last.ipoc) == (Belief.BELIEVED, STEP, LAST)
    return one


@pytest.fixture
def believed():
    """See `begun`."""
    return begun()


def test_a_session_is_confirmed_by_the_last_of_its_first_telegrams_and_answered_from_there():
    one = session()
    assert (one.belief, one.step, one.last) == (Belief.UNKNOWN, None, None)
    assert session().judge(telegram(BEGIN), 0.0) == (TelegramKind.FOREIGN, Answer.UNMOVED, "")
    assert confirm(one) == [TelegramKind.FOREIGN] * (CONFIRMATIONS - 1) + [TelegramKind.CONFIRMED]
    assert one.judge(telegram(LAST + STEP), CONFIRMATIONS * CYCLE_S) == (
        TelegramKind.NEXT,
        Answer.SETPOINT,
        "",
    )


def test_exactly_one_row_of_the_automaton_applies_to_each_possible_belief_and_kind():
    keys = [(row.belief, row.kind) for row in AUTOMATON]
    assert len(set(keys)) == len(keys)


def test_telegrams_up_to_twice_the_rate_of_a_krc_are_believed_and_faster_ones_are_not():
    for pace, kind in ((0.51, TelegramKind.CONFIRMED), (0.49, TelegramKind.FOREIGN)):
        one = session()
        for number in range(CONFIRMATIONS):
            last = one.judge(telegram(BEGIN + number * STEP), 5.0 + number * pace * CYCLE_S).kind
        assert last is kind


def test_a_session_is_confirmed_only_after_a_slow_enough_run():
    one = session()
    kinds = [one.judge(telegram(BEGIN + number * STEP), number * 0.3 * CYCLE_S).kind for number in range(6)]
    assert kinds == [TelegramKind.FOREIGN] * 5 + [TelegramKind.CONFIRMED]


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("field", ["q", "programmed"])
@pytest.mark.parametrize("sign", [1, -1])
def test_telegrams_of_a_robot_that_does_not_stand_still_do_not_agree(joint, field, sign):
    for share, kind in ((0.99, TelegramKind.CONFIRMED), (1.01, TelegramKind.FOREIGN)):
        one = session()
        for number in range(CONFIRMATIONS):
            place = FR.home.copy()
            place[joint] += sign * number * share * STILL
            last = one.judge(telegram(BEGIN + number * STEP, **{field: place}), number * CYCLE_S).kind
        assert last is kind


def test_a_change_of_a_joint_by_exactly_the_bound_is_motion():
    one = session()
    for number in range(2 * CONFIRMATIONS):
        told = telegram(BEGIN + number * STEP, np.full(6, number % 2 * STILL))
        assert one.judge(told, number * CYCLE_S).kind is TelegramKind.FOREIGN


def test_telegrams_partly_without_programmed_position_do_not_agree():
    one = session()
    for number in range(2 * CONFIRMATIONS):
        said = telegram(BEGIN + number * STEP, programmed=FR.home if number % 2 else None)
        assert one.judge(said, number * CYCLE_S).kind is TelegramKind.FOREIGN
    assert confirm(session(), programmed=None)[-1] is TelegramKind.CONFIRMED


@pytest.mark.parametrize("step", [1, 1000])
def test_steps_of_the_ipoc_up_to_a_second_are_learned_and_no_larger_ones(step):
    assert confirm(session(), step=step)[-1] is TelegramKind.CONFIRMED
    assert confirm(session(), step=1001)[-1] is TelegramKind.FOREIGN


def test_steps_that_differ_do_not_agree():
    one = session()
    ipocs = [BEGIN, BEGIN + 12, BEGIN + 25, BEGIN + 37, BEGIN + 50, BEGIN + 62]
    kinds = [one.judge(telegram(ipoc), number * CYCLE_S).kind for number, ipoc in enumerate(ipocs)]
    assert set(kinds) == {TelegramKind.FOREIGN}


def test_a_step_that_is_given_is_known_at_once_and_no_other_agrees():
    one = session(ipoc_step=4)
    assert one.step == 4
    assert set(confirm(one, step=12)) == {TelegramKind.FOREIGN}
    assert confirm(session(ipoc_step=4), step=4)[-1] is TelegramKind.CONFIRMED


def test_before_a_session_a_repeated_telegram_is_neither_answered_nor_counted():
    one = session()
    for number in range(CONFIRMATIONS - 1):
        told = telegram(BEGIN + number * STEP)
        assert one.judge(told, number * CYCLE_S).kind is TelegramKind.FOREIGN
        assert one.judge(told, number * CYCLE_S)[:2] == (TelegramKind.REPEATED, Answer.NOTHING)
    assert one.judge(telegram(LAST), 1.0).kind is TelegramKind.CONFIRMED


@pytest.mark.parametrize("behind", [0, 1, BEHIND])
def test_an_overtaken_telegram_is_not_answered(believed, behind):
    judged = believed.judge(telegram(LAST - behind * STEP), CYCLE_S)
    assert judged == (TelegramKind.REPEATED, Answer.NOTHING, "")
    assert believed.belief is Belief.BELIEVED
    assert believed.judge(telegram(LAST + STEP), CYCLE_S).kind is TelegramKind.NEXT


@pytest.mark.parametrize("ipoc", [LAST - (BEHIND + 1) * STEP, LAST - 7, LAST + 7, LAST + 5 * STEP])
def test_a_telegram_of_another_clock_is_foreign_and_moves_nothing(believed, ipoc):
    assert believed.judge(telegram(ipoc), CYCLE_S) == (TelegramKind.FOREIGN, Answer.UNMOVED, "")
    assert believed.belief is Belief.DOUBTED
    assert believed.judge(telegram(LAST + STEP), CYCLE_S)[:2] == (TelegramKind.NEXT, Answer.SETPOINT)
    assert believed.belief is Belief.BELIEVED


@pytest.mark.parametrize("elapsed", [0, 1, 7])
def test_the_ipoc_may_run_ahead_of_the_elapsed_time_by_the_jitter_and_no_further(elapsed):
    time_s = elapsed * CYCLE_S + 1e-6
    for ahead, kind in ((elapsed + JITTER, TelegramKind.NEXT), (elapsed + JITTER + 1, TelegramKind.FOREIGN)):
        one = begun()
        assert one.judge(telegram(LAST + ahead * STEP), time_s).kind is kind


def test_a_session_survives_losses_shorter_than_the_silence(believed):
    lost = round(SILENCE_S / CYCLE_S)
    assert believed.judge(telegram(LAST + (lost + 1) * STEP), 9.0).kind is TelegramKind.FOREIGN
    assert believed.judge(telegram(LAST + lost * STEP), 9.0).kind is TelegramKind.NEXT


def test_with_a_timeout_below_a_cycle_the_next_telegram_still_belongs_to_the_session():
    one = session(silence_s=0.3 * CYCLE_S)
    confirm(one, begin_s=-(CONFIRMATIONS - 1) * CYCLE_S)
    assert one.judge(telegram(LAST + 2 * STEP), CYCLE_S).kind is TelegramKind.FOREIGN
    assert one.judge(telegram(LAST + STEP), CYCLE_S).kind is TelegramKind.NEXT


def test_the_time_counts_from_the_newest_telegram_of_the_session(believed):
    for number in range(1, 30):
        assert believed.judge(telegram(LAST + number * STEP), number * CYCLE_S).kind is TelegramKind.NEXT
    assert believed.last.ipoc == LAST + 29 * STEP
    for ahead, kind in ((30 + JITTER + 1, TelegramKind.FOREIGN), (30 + JITTER, TelegramKind.NEXT)):
        assert believed.judge(telegram(LAST + ahead * STEP), 30.1 * CYCLE_S).kind is kind


@pytest.mark.parametrize("cycles", [1, 3])
def test_a_joint_that_cannot_have_moved_so_far_makes_a_telegram_garbled(cycles):
    bound = Plausibility.of(FR, CYCLE_S)
    furthest = cycles * np.array(bound.reach) + np.array(bound.resolution)
    for share, kind in ((0.999, TelegramKind.NEXT), (1.001, TelegramKind.GARBLED)):
        one = begun()
        judged = one.judge(telegram(LAST + cycles * STEP, FR.home + share * furthest), cycles * CYCLE_S)
        assert judged.kind is kind
    assert judged.answer is Answer.LAST
    assert judged.why.startswith(f"a1 cannot have moved so far in {cycles} cycles: ")


def test_a_garbled_telegram_does_not_change_the_session(believed):
    far = FR.home + 1.0
    assert believed.judge(telegram(LAST + STEP, far), CYCLE_S).kind is TelegramKind.GARBLED
    assert (believed.belief, believed.last.ipoc) == (Belief.BELIEVED, LAST)
    assert believed.judge(telegram(LAST + 2 * STEP), 2 * CYCLE_S).kind is TelegramKind.NEXT


def test_another_programmed_position_is_garbled_unless_the_robot_stands_there(believed):
    elsewhere, near = FR.home + 0.2, FR.tracking_tolerance
    judged = believed.judge(telegram(LAST + STEP, programmed=elsewhere), CYCLE_S)
    assert judged[:2] == (TelegramKind.GARBLED, Answer.LAST)
    assert judged.why == "its programmed position is neither the session's nor the robot's"
    for sign in (1, -1):
        off = telegram(LAST + STEP, elsewhere + sign * 1.01 * near, elsewhere)
        assert believed.judge(off, CYCLE_S).kind is TelegramKind.GARBLED
        there = telegram(LAST + STEP, elsewhere + sign * 0.99 * near, elsewhere)
        assert believed.judge(there, CYCLE_S) == (TelegramKind.FOREIGN, Answer.UNMOVED, "")
    on_the_bound = telegram(LAST + STEP, near, np.zeros(6))
    assert believed.judge(on_the_bound, CYCLE_S).kind is TelegramKind.FOREIGN
    one_joint_off = elsewhere.copy()
    one_joint_off[2] += 2 * near[2]
    assert (
        believed.judge(telegram(LAST + STEP, one_joint_off, elsewhere), CYCLE_S).kind is TelegramKind.GARBLED
    )


def test_a_suddenly_missing_programmed_position_is_garbled(believed):
    assert believed.judge(telegram(LAST + STEP, programmed=None), CYCLE_S).kind is TelegramKind.GARBLED


def test_another_session_is_believed_when_the_last_has_been_silent_for_its_time_and_no_earlier():
    for silent_s, kind in ((SILENCE_S - 1e-9, TelegramKind.FOREIGN), (SILENCE_S, TelegramKind.CONFIRMED)):
        one = begun()
        for number in range(CONFIRMATIONS):
            time_s = silent_s - (CONFIRMATIONS - 1 - number) * CYCLE_S
            last = one.judge(telegram(5_000_000 + number * STEP), time_s).kind
            assert last is (kind if number == CONFIRMATIONS - 1 else TelegramKind.FOREIGN)


def test_a_telegram_of_the_session_ends_the_count_of_foreign_ones(believed):
    for number in range(CONFIRMATIONS - 1):
        believed.judge(telegram(5_000_000 + number * STEP), 0.1 + number * CYCLE_S)
    time_s = 0.1 + CONFIRMATIONS * CYCLE_S
    assert believed.judge(telegram(LAST + 5 * STEP), time_s).kind is TelegramKind.NEXT
    later_s = time_s + SILENCE_S + 1.0
    last = believed.judge(telegram(5_000_000 + (CONFIRMATIONS - 1) * STEP), later_s)
    assert last.kind is TelegramKind.FOREIGN


def test_a_clock_set_back_for_good_is_another_session_once_the_last_is_silent(believed):
    begin = LAST - 50 * STEP
    kinds = confirm(believed, begin_s=SILENCE_S, begin=begin)
    assert kinds == [TelegramKind.REPEATED] + [TelegramKind.FOREIGN] * (CONFIRMATIONS - 2) + [
        TelegramKind.CONFIRMED
    ]
    assert believed.last.ipoc == begin + (CONFIRMATIONS - 1) * STEP


def test_a_restart_telegram_ends_the_count_and_puts_the_session_in_doubt(believed):
    believed.interrupted()
    assert believed.belief is Belief.DOUBTED
    assert believed.judge(telegram(LAST + STEP, FR.home + 1.0), CYCLE_S)[:2] == (
        TelegramKind.GARBLED,
        Answer.NOTHING,
    )
    one = session()
    confirm(one, count=CONFIRMATIONS - 1)
    one.interrupted()
    assert one.belief is Belief.UNKNOWN
    assert one.judge(telegram(LAST), 1.0).kind is TelegramKind.FOREIGN


def test_the_ipoc_may_wrap_during_confirmation_and_within_a_session():
    one = session()
    begin = 2**32 - 2 * STEP
    assert confirm(one, begin=begin)[-1] is TelegramKind.CONFIRMED
    assert one.step == STEP
    one = session()
    confirm(one, begin=begin - CONFIRMATIONS * STEP)
    ipoc = begin - STEP
    for number in range(4):
        told = telegram(ipoc + (number + 1) * STEP)
        assert one.judge(told, (CONFIRMATIONS + number) * CYCLE_S).kind is TelegramKind.NEXT
    assert one.judge(telegram(ipoc), (CONFIRMATIONS + 4) * CYCLE_S).kind is TelegramKind.REPEATED


# Whom a Robot Server listens to.

KRC = ("127.0.0.1", 40_000)
OTHER = ("127.0.0.1", 40_001)
PEER_SILENCE_S = 0.25


def test_on_the_loopback_the_first_valid_telegram_names_the_krc():
    peer = Peer(None, PEER_SILENCE_S)
    assert (peer.address, peer.stranger) == (None, "")
    assert peer.judge(OTHER, 0.0) is DatagramSource.KRC
    assert peer.judge(KRC, 0.0) is DatagramSource.KRC  # the other has not said anything valid
    peer.believed(KRC, 0.0)
    assert peer.judge(KRC, 0.1) is DatagramSource.KRC
    assert peer.judge(OTHER, 0.1) is DatagramSource.SECOND_KRC
    assert peer.stranger == "a second KRC at 127.0.0.1:40001"


def test_the_krc_may_come_from_another_port_after_it_was_silent():
    peer = Peer(None, PEER_SILENCE_S)
    peer.believed(KRC, 0.0)
    peer.believed(KRC, 1.0)
    assert peer.judge(OTHER, 1.0 + PEER_SILENCE_S) is DatagramSource.SECOND_KRC
    assert peer.judge(OTHER, 1.01 + PEER_SILENCE_S) is DatagramSource.KRC
    peer.believed(OTHER, 1.3)
    assert peer.judge(KRC, 1.3) is DatagramSource.SECOND_KRC
    assert peer.address == OTHER


def test_a_sender_recognised_as_the_krc_is_no_longer_foreign():
    peer = Peer(None, PEER_SILENCE_S)
    peer.believed(KRC, 0.0)
    peer.judge(OTHER, 0.1)
    peer.believed(KRC, 0.1)
    assert peer.stranger
    peer.believed(OTHER, 1.0)
    assert peer.stranger == ""


@pytest.mark.parametrize("learned", [False, True])
def test_only_the_address_of_the_krc_is_accepted(learned):
    peer = Peer("192.168.10.20", PEER_SILENCE_S)
    if learned:
        peer.believed(("192.168.10.20", 49_152), 0.0)
    for now_s in (0.0, 9.0):
        assert peer.judge(("192.168.10.66", 49_152), now_s) is DatagramSource.FOREIGN
        assert peer.stranger == "a foreign sender at 192.168.10.66:49152"
        assert peer.judge(("192.168.10.20", 49_152), now_s) is DatagramSource.KRC


def test_a_sender_without_a_port_could_not_be_answered():
    peer = Peer(None, PEER_SILENCE_S)
    assert peer.judge(("127.0.0.1", 0), 0.0) is DatagramSource.FOREIGN


# Telegrams by the million: whatever comes, a correction changes only where an admission or its brake explains it.


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_no_telegram_moves_the_robot(seed):
    storm = Storm(seed)
    storm.run(8_000)
    assert storm.answers > 2_500
    assert storm.admitted > 1_000
    assert storm.krc.counters["session_restarted"] >= storm.sessions
    for counter in ("telegrams_implausible", "reply_missed", "braked_cycles"):
        assert storm.krc.counters[counter] > 0, counter


@pytest.mark.nightly
@pytest.mark.timeout(0)
@pytest.mark.parametrize("seed", range(1000, 1020))
def test_no_telegram_of_ten_million_moves_the_robot(seed):
    storm = Storm(seed)
    storm.run(500_000)
    assert storm.sessions > 0
