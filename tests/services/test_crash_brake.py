"""The brake of a robot whose Robot Server has died: from its last record to rest, by the KRC's telegrams alone."""

import math
import mmap
import random
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from crash_bench import PEER, PLAN, RECORDS, TELEGRAMS, CrashSide
from hypothesis import given
from hypothesis import strategies as st
from krc_side import CELL, FR, MAX_DV, XML, KrcSide

from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_services.robot_server.crash_brake.core import STOP_CYCLES, CrashBrake, CrashPlan
from deltaq_services.robot_server.crash_brake.memory import CrashMemory
from deltaq_services.robot_server.crash_brake.record import SENT, CrashRecord, CrashRecords
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


def test_it_sends_the_certified_brake_exactly_as_encoded(krc):
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


def test_a_krc_with_a_text_element_gets_an_empty_text(krc, tmp_path):
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


def test_it_waits_for_the_lag_of_the_drives_sends_the_stop_and_ends(krc):
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


def test_without_a_stop_a_resting_robot_needs_no_action():
    krc = CrashSide().begin()
    brake = CrashBrake(replace(PLAN, has_stop=False), RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    assert brake.over
    assert krc.after(brake) is None


def test_without_a_stop_it_ends_when_the_drives_have_caught_up(krc):
    n = krc.server.state.plan.brake_cycles
    brake = CrashBrake(replace(PLAN, has_stop=False), RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    assert not any(told.outputs["stop"] for told in krc.until_over(brake))
    assert brake.replies == n + PLAN.lag_cycles


def test_a_possibly_unsent_reply_is_repeated_and_none_is_skipped(krc):
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


def test_it_ends_if_the_krc_misses_every_reply(krc):
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


def test_a_record_older_than_the_krc_timeout_moves_nothing(krc):
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
def test_a_foreign_datagram_is_not_answered_and_hides_no_telegram(krc, wrong):
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


def test_of_waiting_telegrams_the_newest_is_answered_by_one_step(krc):
    brake, before = krc.dead(), krc.correction.copy()
    older = []
    for _ in range(3):
        krc.tick()
        older.append((krc.own(), PEER))
    told = krc.after(brake, *older)
    assert told.ipoc == krc.ipoc
    dq, n = np.array(krc.server.state.plan.dq), krc.server.state.plan.brake_cycles
    assert told.correction - before == pytest.approx(brake_increment(dq, n, 1), abs=ROUNDING)


def test_the_ipoc_wraps_at_32_bit():
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


def test_the_last_check_keeps_a_robot_in_place(krc):
    found = RECORDS.newest(bytes(krc.memory))
    leap = replace(found.record, plan_dq=tuple(2 * most for most in PLAN.most), brake_cycles=4)
    brake, before = CrashBrake(PLAN, found._replace(record=leap), TELEGRAMS), krc.correction.copy()
    moved = moves(krc, brake) - before
    assert not moved.any()
    assert krc.stop


def test_a_record_shows_whether_its_reply_was_sent(krc):
    assert krc.dead()._is_sent
    SENT.pack_into(krc.memory, RECORDS.sent_at, krc.number - 1)
    assert not krc.dead()._is_sent


def test_the_number_of_braked_cycles_agrees_with_the_certificate(krc):
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


def test_a_brake_too_long_for_a_record_leaves_none(krc):
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


def test_a_reply_refused_by_the_last_check_leaves_a_resting_robot(krc):
    krc.driver.fault = "leaps"
    left = krc.maker.of_last(krc.own(), krc.ipoc, {}, krc.server.motion)
    assert left.rests
    assert left.correction == krc.driver.correction
    assert not any(left.plan_dq)


def test_a_plan_survives_a_round_trip():
    assert CrashPlan.from_json(PLAN.json()) == PLAN


def test_an_unconfirmed_reply_is_repeated_without_a_counted_late_one(krc):
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


def test_with_a_timeout_of_one_cycle_no_setpoint_is_skipped(krc):
    impatient = replace(PLAN, silence_s=PLAN.cycle_s)
    brake = CrashBrake(impatient, RECORDS.newest(bytes(krc.memory)), TELEGRAMS)
    now_s = krc.time_s
    krc.tick()
    krc.tick()
    assert brake.answer([(krc.own(), PEER)], now_s) is None
    assert not brake.over


# The record that a Robot Server leaves before each reply: whatever a kill does to it, no motion is invented.

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


def joints(values=numbers):
    return st.tuples(*[values] * 6)


records = st.builds(
    CrashRecord,
    ipoc=st.integers(0, 2**32 - 1),
    late=st.integers(-(2**40), 2**40),
    programmed=st.integers(0, 2**32 - 1),
    ipoc_step=st.integers(1, 1000),
    outputs=st.tuples(st.booleans(), st.booleans(), st.booleans()),
    correction=joints(),
    plan_dq=joints(),
    brake_cycles=st.integers(1, 1000),
    step=st.integers(0, 1000),
    lower=joints(st.floats(allow_nan=False)),
    upper=joints(st.floats(allow_nan=False)),
)
LAYOUT = CrashRecords(6, 3)


def left(bodies, sent=None):
    """Memory after records one to `len(bodies)`, of which `sent` was sent last."""
    memory = bytearray(LAYOUT.total)
    for number, body in enumerate(bodies, 1):
        place, record = LAYOUT.sealed(body, number, PEER, 0.5 * number)
        memory[place : place + len(record)] = record
    SENT.pack_into(memory, LAYOUT.sent_at, len(bodies) if sent is None else sent)
    return memory


@pytest.mark.long
@given(records, records)
def test_the_newest_record_survives_a_round_trip(older, newer):
    found = LAYOUT.newest(bytes(left([LAYOUT.body(older), LAYOUT.body(newer)])))
    assert found == (newer, PEER, 1.0, True)


@pytest.mark.long
@given(records, records, st.data())
def test_a_torn_write_leaves_the_previous_record(older, newer, data):
    memory = left([LAYOUT.body(older), LAYOUT.body(older)], sent=2)
    place, record = LAYOUT.sealed(LAYOUT.body(newer), 3, PEER, 1.5)
    end = data.draw(st.integers(0, len(record) - 1))
    torn = memory.copy()
    torn[place : place + end] = record[:end]
    found = LAYOUT.newest(bytes(torn))
    assert found is not None
    assert found.time_s in (1.0, 1.5)
    assert (found.record, found.was_sent) == ((older, True) if found.time_s == 1.0 else (newer, False))


@pytest.mark.long
@given(records, records, st.data())
def test_any_flipped_byte_gives_the_same_the_older_or_no_record(older, newer, data):
    memory = left([LAYOUT.body(older), LAYOUT.body(newer)])
    at = data.draw(st.integers(0, len(memory) - 1))
    memory[at] ^= data.draw(st.integers(1, 255))
    found = LAYOUT.newest(bytes(memory))
    if found is not None:
        assert found.record in (older, newer)
        # the older one is gone on from only if the newer was not sent
        assert found.time_s == 1.0 or not found.was_sent
        assert found.time_s == 1.0 or SENT.unpack_from(memory, LAYOUT.sent_at)[0] <= 1


def test_with_any_byte_of_the_newest_flipped_after_it_was_sent_nothing_moves():
    krc = CrashSide().begin().run_up(4)
    place = (krc.number & 1) * RECORDS.size
    length = len(RECORDS.sealed(krc.record(krc.own()), krc.number, PEER, 0.0)[1])
    for at in range(place, place + length):
        memory = krc.memory.copy()
        memory[at] ^= 1
        assert RECORDS.newest(bytes(memory)) is None


def test_without_a_record_nothing_is_found():
    assert LAYOUT.newest(bytes(LAYOUT.total)) is None
    # a checksum of nothing but zeros is none of a record either
    memory = bytearray(LAYOUT.total)
    place, record = LAYOUT.sealed(bytes(len(LAYOUT.body(some()))), 0, ("0.0.0.0", 0), 0.0)
    memory[place : place + len(record)] = record
    assert LAYOUT.newest(bytes(memory)) is None


def some():
    zeros = (0.0,) * 6
    return CrashRecord(0, 0, 0, 1, (False,) * 3, zeros, zeros, 1, 1, zeros, (math.inf,) * 6)


def test_the_number_of_the_sent_reply_is_written_atomically():
    assert SENT.size == struct.calcsize("Q") == 8
    assert LAYOUT.sent_at % SENT.size == 0


@pytest.mark.parametrize(("joints", "outputs"), [(6, 0), (6, 3), (9, 5)])
def test_records_are_word_aligned_and_followed_by_the_sent_number(joints, outputs):
    layout = CrashRecords(joints, outputs)
    zeros = (0.0,) * joints
    record = replace(
        some(), outputs=(True,) * outputs, correction=zeros, plan_dq=zeros, lower=zeros, upper=zeros
    )
    memory = bytearray(layout.total)
    ends = []
    for number in (2, 3):
        place, whole = layout.sealed(layout.body(record), number, PEER, 0.5)
        memory[place : place + len(whole)] = whole
        assert place == (number - 2) * layout.size
        ends.append(place + len(whole))
    assert layout.size % 8 == 0
    assert layout.size - 8 < ends[0] <= layout.size
    assert ends[1] <= layout.sent_at == 2 * layout.size
    assert layout.total == layout.sent_at + 8
    SENT.pack_into(memory, layout.sent_at, 3)
    assert layout.newest(bytes(memory)) == (record, PEER, 0.5, True)


def test_the_memory_has_the_written_records_and_the_sent_number():
    bodies = [LAYOUT.body(replace(some(), ipoc=ipoc)) for ipoc in (1, 2, 3)]
    with mmap.mmap(-1, CrashMemory.bytes_for(LAYOUT)) as file:
        memory = CrashMemory(file, LAYOUT)
        memory.write(bodies[0], PEER, 0.5)
        memory.write(bodies[1], PEER, 1.0)
        memory.sent()
        assert file[: LAYOUT.total] == bytes(left(bodies[:2]))
        memory.write(bodies[1], PEER, 1.5)
        memory.write(bodies[1], PEER, 2.0)
        memory.sent()
        assert file[: LAYOUT.total] == bytes(left([*bodies[:2], bodies[1], bodies[1]]))
        memory.close()


# Robot Servers that die in any cycle of any motion, before a KRC on a bad wire among strangers.

_MOST = FR.max_velocity * 0.012


class Death:
    """One death, and what came after it.

    Attributes:
        course: corrections that the brake may reach, in order (m, n); the first is the one that the KRC has.
        at: which of them the KRC has.
    """

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.krc = CrashSide().begin()
        self._move()
        self.course, self.at = self._die(), 0
        self.brake = self.krc.dead()

    def _move(self):
        krc, draw = self.krc, self.random
        for _ in range(draw.randint(1, 40)):
            if draw.random() < 0.15:
                krc.cycle()  # it brakes
                continue
            wanted = np.array(krc.server.state.dq) + MAX_DV * np.array(
                [draw.uniform(-1.0, 1.0) for _ in range(6)]
            )
            krc.cycle(krc.admission(np.clip(wanted, -0.9 * _MOST, 0.9 * _MOST)))

    def _die(self):
        """The last moments: between two cycles, or with a telegram in hand, its reply unsent, or sent and not noted."""
        krc, how = self.krc, self.random.choice(["between", "read", "recorded", "on its way", "not noted"])
        begin = krc.correction.copy()
        dq, step = np.array(krc.server.state.plan.dq), krc.server.state.plan.step
        if how == "between":
            return self._line(begin, dq, step)
        krc.tick()
        own = krc.own()
        if how != "read":
            admission = krc.admission(np.clip(np.array(krc.server.state.dq) + 0.7 * MAX_DV, -_MOST, _MOST))
            answer = krc.codec.decode(krc.answer(own, admission))
            krc.leave(own, is_sent=how == "on its way")
            dq, step = np.array(krc.server.state.plan.dq), krc.server.state.plan.step
            line = self._line(answer.correction, dq, step)
            if how == "not noted":
                krc.correction = answer.correction
                return line
            krc.late += 1
            return np.vstack([begin, line]) if np.any(line[0] != begin) else line
        krc.late += 1
        return self._line(begin, dq, step)

    @staticmethod
    def _line(begin, dq, step):
        cycles = max(1, math.ceil(np.max(np.abs(dq) / MAX_DV) - 1e-6))
        left = [dq * (cycles - k) / cycles for k in range(step + 1, cycles)]
        return np.cumsum([begin, *left], axis=0)

    def run(self):
        for _ in range(400):
            if self.brake.over:
                return
            self._cycle()
        pytest.fail("it never ended")

    def _cycle(self):
        krc, draw = self.krc, self.random
        before, replies = self.brake.correction, self.brake.replies
        krc.tick()
        waiting = [self._rubbish() for _ in range(draw.choice([0, 0, 1, 3]))]
        if draw.random() < 0.9:
            waiting.insert(draw.randint(0, len(waiting)), (krc.own(), PEER))
        reply = self.brake.answer(waiting, krc.time_s)
        assert self.brake.replies - replies == (reply is not None)
        self._judge_step(np.array(before), np.array(self.brake.correction))
        told = krc.codec.decode(reply) if reply is not None else None
        # a reply to a telegram that came late is late to the KRC, which takes it as none
        arrives = told is not None and told.ipoc == krc.ipoc and draw.random() < 0.9
        if told is not None and arrives:
            self._krc_moves(told.correction)
            krc.stop = told.outputs["stop"]
            assert not krc.stop or self.at == len(self.course) - 1
        else:
            krc.late += 1

    def _judge_step(self, before, after):
        """One reply goes no further than an increment from the one before it."""
        assert np.all(np.abs(after - before) <= _MOST * (1 + 1e-6))

    def _krc_moves(self, correction):
        """The KRC may stay, or go to the next place on the line: never further, never off it, never back."""
        nexts = self.course[self.at : self.at + 2]
        off = np.abs(nexts - correction).max(axis=1)
        assert off.min() <= ROUNDING, f"it is at none of its next places: off by {off}"
        self.at += int(off.argmin()) if off.min() < off[0] else 0
        self.krc.correction = correction

    def _rubbish(self):
        own, draw = self.krc.own(), self.random
        kind = draw.randrange(6)
        if kind == 0:
            return own[: draw.randrange(len(own))], PEER
        if kind == 1:
            place = draw.randrange(len(own))
            return own[:place] + bytes([draw.choice(b"<>\x00zX/")]) + own[place:], PEER
        if kind == 2:
            return own, ("192.0.2.17", 1)
        if kind == 3:
            return own, ("192.0.2.99", PEER[1])
        shift = draw.choice([-120, -12, -5, 1, 7, 12 * 1000])
        shifted = re.sub(rb"<IPOC>(\d+)<", lambda m: b"<IPOC>%d<" % (int(m[1]) + shift), own)
        if kind == 4:
            return shifted, PEER
        return self.krc.own(programmed=FR.home + draw.uniform(0.001, 1.0)), PEER


@pytest.mark.long
@pytest.mark.parametrize(
    "block", [0, *(pytest.param(block, marks=pytest.mark.nightly) for block in range(1, 8))]
)
def test_on_any_wire_the_robot_stays_on_its_brake_and_comes_to_rest(block):
    rested = 0
    for seed in range(100 * block, 100 * block + 100):
        death = Death(seed)
        death.run()
        rested += death.at == len(death.course) - 1
    assert rested > 90  # others ended where the KRC was silent for too long


@pytest.mark.parametrize("seed", range(40))
def test_on_a_good_wire_the_brake_keeps_acceleration_limits_to_its_end(seed):
    krc = CrashSide().begin()
    draw = random.Random(seed)
    for _ in range(draw.randint(1, 40)):
        wanted = np.array(krc.server.state.dq) + MAX_DV * np.array(
            [draw.uniform(-1.0, 1.0) for _ in range(6)]
        )
        krc.cycle(krc.admission(np.clip(wanted, -0.9 * _MOST, 0.9 * _MOST)))
    brake = krc.dead()
    while not brake.over:
        krc.after(brake)
    steps = np.diff(np.array(krc.setpoints), axis=0)
    assert np.all(np.abs(np.diff(steps, axis=0)) <= MAX_DV * (1 + 1e-6) + 4 * ROUNDING)
    assert not steps[-STOP_CYCLES:].any()
    assert krc.stop
