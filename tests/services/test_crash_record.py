"""The record that a Robot Server leaves before each reply: whatever a kill does to it, no motion is invented."""

import math
import mmap
import struct
from dataclasses import replace

import pytest
from crash_bench import PEER, RECORDS, CrashSide
from hypothesis import given
from hypothesis import strategies as st

from deltaq_services.robot_server.crash_brake.memory import CrashMemory
from deltaq_services.robot_server.crash_brake.record import SENT, CrashRecord, CrashRecords

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
def test_the_newest_is_read_as_it_was_written(older, newer):
    found = LAYOUT.newest(bytes(left([LAYOUT.body(older), LAYOUT.body(newer)])))
    assert found == (newer, PEER, 1.0, True)


@pytest.mark.long
@given(records, records, st.data())
def test_a_write_torn_anywhere_leaves_the_one_before(older, newer, data):
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
def test_with_any_byte_flipped_it_is_the_same_record_or_the_older_or_none(older, newer, data):
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


def test_where_nothing_was_left_nothing_is_found():
    assert LAYOUT.newest(bytes(LAYOUT.total)) is None
    # a checksum of nothing but zeros is none of a record either
    memory = bytearray(LAYOUT.total)
    place, record = LAYOUT.sealed(bytes(len(LAYOUT.body(some()))), 0, ("0.0.0.0", 0), 0.0)
    memory[place : place + len(record)] = record
    assert LAYOUT.newest(bytes(memory)) is None


def some():
    zeros = (0.0,) * 6
    return CrashRecord(0, 0, 0, 1, (False,) * 3, zeros, zeros, 1, 1, zeros, (math.inf,) * 6)


def test_the_number_of_the_reply_that_was_sent_is_written_in_one_piece():
    assert SENT.size == struct.calcsize("Q") == 8
    assert LAYOUT.sent_at % SENT.size == 0


@pytest.mark.parametrize(("joints", "outputs"), [(6, 0), (6, 3), (9, 5)])
def test_two_records_lie_apart_in_whole_words_and_the_number_that_was_sent_behind_them(joints, outputs):
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


def test_memory_holds_the_records_that_were_written_and_the_number_of_the_one_that_was_sent():
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
