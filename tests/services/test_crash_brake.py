"""The brake of a robot whose Robot Server has died: from its last record to rest, by the KRC's telegrams alone."""

import re
from dataclasses import replace

import numpy as np
import pytest
from crash_bench import PEER, PLAN, RECORDS, TELEGRAMS, CrashSide
from krc_side import CELL, FR, MAX_DV, XML, KrcSide

from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_services.robot_server.crash_brake.core import STOP_CYCLES, CrashBrake, CrashPlan
from deltaq_services.robot_server.crash_brake.record import SENT
from deltaq_services.robot_server.rsi_driver import crash_plan, sensor_codec

ROUNDING = 2e-8
"""Of six decimals of a degree, twice [rad]."""


@pytest.fixture
def krc():
    """A KRC whose robot moves with all its joints."""
    return CrashSide().begin().run_up(4)


def moves(krc, brake):
    """Corrections of the KRC's cycles until the brake is over."""
    begin = len(krc.setpoints) - 1
    assert list(krc.until_over(brake))
    return np.array(krc.setpoints[begin:])


def test_it_sends_the_certified_brake_to_the_bit_of_the_codec(krc):
    state = krc.server.state
    dq, n = np.array(state.plan.dq), state.plan.brake_cycles
    correction = np.array(krc.driver.correction)
    brake, codec = krc.dead(), sensor_codec(CELL, "fr", XML)
    for step in range(1, n + 1):
        krc.tick()
        reply = brake.answer([(krc.own(), PEER)], krc.time_s)
        correction = correction + brake_increment(dq, n, step)
        assert reply == codec.encode(krc.ipoc, correction, krc.server.outputs)
    assert brake.at_rest
    assert not brake.over


def test_where_a_krc_has_a_place_for_a_text_it_is_told_none(krc, tmp_path):
    xml = tmp_path / "with_text.xml"
    text = '<ELEMENTS><ELEMENT TAG="DEF_EStr" TYPE="STRING" INDX="INTERNAL" />'
    before, receive, after = XML.read_text(encoding="utf-8").partition("<RECEIVE>")
    xml.write_text(before + receive + after.replace("<ELEMENTS>", text, 1), encoding="utf-8")
    plan, codec = crash_plan(CELL, "fr", xml), sensor_codec(CELL, "fr", xml)
    brake = CrashBrake(plan, RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    krc.tick()
    reply = brake.answer([(krc.own(), PEER)], krc.time_s)
    assert b"<EStr></EStr>" in reply
    assert reply == codec.encode(krc.ipoc, np.array(brake.correction), krc.server.outputs)


def test_tags_that_begin_with_a_digit_are_read_and_answered(krc, tmp_path):
    xml = tmp_path / "digits.xml"
    own = '<ELEMENT TAG="Out.01" TYPE="BOOL" INDX="9" HOLDON="1" /></ELEMENTS>'
    xml.write_text(XML.read_text(encoding="utf-8").replace("</ELEMENTS>", own), encoding="utf-8")
    side = KrcSide(xml=xml).begin().run_up(2)
    assert b'<Out 01="0"/>' in side.own()
    plan = crash_plan(CELL, "fr", xml)
    brake = CrashBrake(plan, RECORDS.newest(bytes(krc.memory)), plan.telegrams())
    krc.tick()
    reply = brake.answer([(krc.own().replace(b"<IPOC>", b'<Out 01="0"/><IPOC>'), PEER)], krc.time_s)
    assert b'<Out 01="0"/><IPOC>' in reply


def test_it_rests_for_the_drives_lag_then_sends_the_stop_and_is_over(krc):
    n, brake = krc.server.state.plan.brake_cycles, krc.dead()
    stops = [told.outputs["stop"] for told in krc.until_over(brake)]
    assert stops == [False] * (n + PLAN.lag_cycles) + [True] * STOP_CYCLES
    assert krc.after(brake) is None
    assert brake.replies == len(stops)


def test_a_robot_that_rests_gets_the_stop_at_once():
    krc = CrashSide().begin()
    brake = krc.dead()
    assert [krc.after(brake).outputs["stop"] for _ in range(STOP_CYCLES)] == [True] * STOP_CYCLES
    assert brake.over


def test_without_a_stop_a_robot_that_rests_needs_nobody():
    krc = CrashSide().begin()
    brake = CrashBrake(replace(PLAN, has_stop=False), RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    assert brake.over
    assert krc.after(brake) is None


def test_without_a_stop_it_ends_when_the_drives_have_caught_up(krc):
    n = krc.server.state.plan.brake_cycles
    brake = CrashBrake(replace(PLAN, has_stop=False), RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    assert not any(told.outputs["stop"] for told in krc.until_over(brake))
    assert brake.replies == n + PLAN.lag_cycles


def test_a_reply_that_may_not_have_been_sent_is_sent_again_and_none_is_skipped(krc):
    before = krc.correction.copy()
    krc.tick()
    datagram = krc.own()
    admission = krc.admission(np.array(krc.server.state.dq) + 0.5 * MAX_DV)
    krc.answer(datagram, admission)  # it was made, and recorded, and then the process died
    krc.leave(datagram, is_sent=False)
    krc.late += 1
    krc.setpoints.append(krc.correction.copy())
    brake = krc.dead()
    assert krc.after(brake) is not None
    moved = krc.correction - before
    assert moved == pytest.approx(np.array(admission.dq), abs=ROUNDING)
    krc.after(brake)
    assert krc.correction - before - moved == pytest.approx(
        brake_increment(np.array(admission.dq), admission.brake_cycles, 1), abs=ROUNDING
    )


def test_a_reply_that_the_krc_missed_is_sent_again(krc):
    brake = krc.dead()
    krc.after(brake)
    sent = brake.correction
    krc.late += 1
    krc.after(brake)
    assert brake.correction == sent
    krc.after(brake)
    assert brake.correction != sent


def test_a_krc_that_misses_every_reply_is_given_up(krc):
    brake = krc.dead()
    sent = brake.correction
    krc.late += 1
    for told in krc.until_over(brake):
        assert told is not None
        krc.late += 1
    assert brake.correction == sent
    assert brake.replies == round(PLAN.silence_s / PLAN.cycle_s) + 1


def test_a_silent_krc_ends_it(krc):
    brake = krc.dead()
    krc.after(brake)
    brake.time_passed(krc.time_s + 0.99 * PLAN.silence_s)
    assert not brake.over
    assert brake.silent_s == pytest.approx(krc.time_s + PLAN.silence_s)
    brake.time_passed(brake.silent_s)
    assert brake.over


def test_a_record_that_is_older_than_the_krcs_timeout_moves_nothing(krc):
    brake = krc.dead()
    krc.tick(21)
    assert krc.time_s - brake.silent_s + PLAN.silence_s > PLAN.silence_s
    assert krc.after(brake) is None
    assert brake.over


def ipoc_of(krc, ipoc):
    krc.ipoc, was = ipoc % 2**32, krc.ipoc
    datagram = krc.own()
    krc.ipoc = was
    return datagram


@pytest.mark.parametrize(
    "wrong",
    [
        lambda krc: (krc.own(), ("192.0.2.17", 49153)),
        lambda krc: (krc.own(), ("192.0.2.18", 49152)),
        lambda krc: (krc.own()[:-1], PEER),
        lambda krc: (krc.own() + b" " * 5000, PEER),
        lambda krc: (b"", PEER),
        lambda krc: (krc.own(programmed=FR.home + 0.001), PEER),
        lambda krc: (ipoc_of(krc, krc.ipoc - 12), PEER),
        lambda krc: (ipoc_of(krc, krc.ipoc - 24), PEER),
        lambda krc: (ipoc_of(krc, krc.ipoc + 1), PEER),
        lambda krc: (ipoc_of(krc, krc.ipoc + 12 * 4), PEER),
        lambda krc: (ipoc_of(krc, krc.ipoc + 2**31), PEER),
        lambda krc: (krc.own().replace(b"<IPOC>", b"<IPOC>9999"), PEER),
        lambda krc: (krc.codec.encode_ipoc_only(krc.ipoc), PEER),
    ],
)
def test_what_is_no_telegram_of_the_krc_that_follows_is_not_answered_and_hides_none(krc, wrong):
    brake, correction = krc.dead(), krc.correction
    krc.tick()
    assert brake.answer([wrong(krc)], krc.time_s) is None
    assert (brake.replies, brake.correction) == (0, krc.driver.correction)
    told = krc.codec.decode(brake.answer([(krc.own(), PEER), wrong(krc)], krc.time_s))
    assert told.ipoc == krc.ipoc
    assert (told.correction != correction).all()


def test_a_telegram_is_answered_once(krc):
    brake = krc.dead()
    krc.after(brake)
    assert brake.answer([(krc.own(), PEER)], krc.time_s) is None
    assert brake.replies == 1


def test_of_telegrams_that_waited_the_newest_is_answered_by_one_step(krc):
    brake, before = krc.dead(), krc.correction.copy()
    older = []
    for _ in range(3):
        krc.tick()
        older.append((krc.own(), PEER))
    told = krc.after(brake, *older)
    assert told.ipoc == krc.ipoc
    dq, n = np.array(krc.server.state.plan.dq), krc.server.state.plan.brake_cycles
    assert told.correction - before == pytest.approx(brake_increment(dq, n, 1), abs=ROUNDING)


def test_its_ipoc_goes_on_over_the_end_of_32_bit():
    krc = CrashSide()
    krc.ipoc = 2**32 - 1 - 12 * 200
    krc.begin()
    while krc.ipoc < 2**32 - 14 * 6:
        krc.cycle()
    krc.run_up(4)
    brake = krc.dead()
    moves(krc, brake)
    assert krc.ipoc < 2**31
    assert brake.at_rest


def test_the_last_check_keeps_a_robot_where_it_is(krc):
    found = RECORDS.newest(bytes(krc.memory))
    leap = replace(found.record, plan_dq=tuple(2 * most for most in PLAN.most), brake_cycles=4)
    brake, before = CrashBrake(PLAN, found._replace(record=leap), TELEGRAMS), krc.correction.copy()
    moved = moves(krc, brake) - before
    assert not moved.any()
    assert krc.stop


def test_what_it_left_while_it_was_sent_says_whether_it_was(krc):
    assert krc.dead()._is_sent
    SENT.pack_into(krc.memory, RECORDS.sent_at, krc.number - 1)
    assert not krc.dead()._is_sent


def test_braked_cycles_are_as_many_as_the_certificate_says(krc):
    dq = np.array(krc.server.state.dq)
    brake = krc.dead()
    moved = np.diff(moves(krc, brake), axis=0)
    last = int(np.flatnonzero(moved.any(axis=1))[-1])
    assert last + 2 == brake_cycles(dq, MAX_DV)
    steps = np.vstack([dq, moved])
    assert np.all(np.abs(np.diff(steps, axis=0)) <= MAX_DV * (1 + 1e-9) + 2 * ROUNDING)


@pytest.mark.parametrize("digits", [b"9e99", b"-9e99", b"9999999999999999e99"])
def test_no_count_of_late_replies_is_too_long_for_a_record(krc, digits):
    krc.tick()
    datagram = re.sub(rb'<Delay D="[^"]*"', b'<Delay D="' + digits + b'"', krc.own())
    krc.hand(datagram)
    krc.leave(datagram)
    assert abs(RECORDS.newest(bytes(krc.memory)).record.late) == 2**62


def test_of_a_brake_that_is_too_long_for_a_record_there_is_none(krc):
    motion = replace(krc.server.motion, brake_cycles=2**32)
    left = krc.maker.of_last(krc.own(), krc.ipoc, {}, motion)
    assert left is not None
    assert krc.maker.body(left) is None


def test_a_telegram_in_another_layout_leaves_no_record(krc):
    session = krc.driver.session
    assert session.last.is_usual
    session.last = session.last._replace(is_usual=False)
    assert krc.maker.of_last(krc.own(), krc.ipoc, {}, krc.server.motion) is None
    assert krc.maker.body(None) is None


def test_a_reply_that_the_last_check_refused_leaves_a_robot_that_rests(krc):
    krc.driver.fault = "leaps"
    left = krc.maker.of_last(krc.own(), krc.ipoc, {}, krc.server.motion)
    assert left.rests
    assert left.correction == krc.driver.correction
    assert not any(left.plan_dq)


def test_a_plan_is_read_as_it_was_written():
    assert CrashPlan.from_json(PLAN.json()) == PLAN


def test_a_reply_that_is_not_known_to_be_sent_is_sent_again_though_no_late_one_was_counted(krc):
    SENT.pack_into(krc.memory, RECORDS.sent_at, krc.number - 1)
    brake, sent = krc.dead(), krc.driver.correction
    krc.after(brake)
    assert brake.correction == sent
    krc.after(brake)
    assert brake.correction != sent


def test_an_ipoc_may_run_three_cycles_ahead_of_the_time_and_no_more(krc):
    brake = krc.dead()
    krc.tick()
    assert brake.answer([(ipoc_of(krc, krc.ipoc + 12 * 4), PEER)], krc.time_s) is None
    assert brake.answer([(ipoc_of(krc, krc.ipoc + 12 * 3), PEER)], krc.time_s) is not None


def test_an_ipoc_is_never_further_ahead_than_a_krc_may_be_silent(krc):
    silence = round(PLAN.silence_s / PLAN.cycle_s)
    brake, ipoc = krc.dead(), krc.ipoc
    krc.tick(silence - 1)
    assert brake.answer([(ipoc_of(krc, ipoc + 12 * (silence + 1)), PEER)], krc.time_s) is None
    assert brake.answer([(ipoc_of(krc, ipoc + 12 * silence), PEER)], krc.time_s) is not None


def test_where_a_krc_may_be_silent_for_no_more_than_a_cycle_none_is_skipped(krc):
    impatient = replace(PLAN, silence_s=PLAN.cycle_s)
    brake = CrashBrake(impatient, RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    now_s = krc.time_s
    krc.tick()
    krc.tick()
    assert brake.answer([(krc.own(), PEER)], now_s) is None
    assert not brake.over
