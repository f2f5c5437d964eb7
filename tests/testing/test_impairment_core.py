"""Faults of streams and lines in virtual time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError
from deltaq_testing.impairment.relay import (
    FaultyLines,
    InvalidFaultError,
    TrafficUnit,
    relay,
    wire_faults,
)
from deltaq_testing.impairment.tcp import MAX_WAITING_BYTES, FaultyStream, StreamFaults

FAULTS = st.builds(
    StreamFaults,
    delay_s=st.floats(0, 1),
    jitter_s=st.floats(0, 1),
    rate_bytes_s=st.none() | st.floats(1, 1e6),
)


@pytest.mark.long
@given(st.lists(st.tuples(FAULTS, st.binary(min_size=1), st.floats(0, 0.5))), st.integers(0, 99))
def test_an_impaired_stream_delivers_all_bytes_in_order_and_none_early(sent, seed):
    stream, now_s, arrived, due_s = FaultyStream(seed), 0.0, [], 0.0
    for faults, chunk, pause_s in sent:
        stream.faults = faults
        due_s = max(due_s, now_s + faults.delay_s)
        stream.put(now_s, chunk)
        now_s += pause_s
        arrived += stream.take(now_s)
    while stream.next_s is not None:
        now_s = max(now_s, stream.next_s)
        arrived += stream.take(now_s)
    assert b"".join(arrived) == b"".join(chunk for _, chunk, _ in sent)
    assert now_s >= due_s
    assert stream.waiting_bytes == 0


def test_a_stalled_stream_keeps_its_bytes_and_delivers_them_at_once():
    stream = FaultyStream()
    stream.put(0.0, b"before")
    assert stream.take(0.0) == [b"before"]
    stream.faults = StreamFaults(stalled=True)
    stream.put(1.0, b"during")
    assert (stream.take(9.0), stream.next_s, stream.waiting_bytes) == ([], None, 6)
    stream.faults = StreamFaults()
    stream.put(9.0, b"after")
    assert stream.take(9.0) == [b"during", b"after"]


def test_a_rate_holds_over_many_chunks():
    stream = FaultyStream()
    stream.faults = StreamFaults(rate_bytes_s=100)
    for _ in range(10):
        stream.put(0.0, b"x" * 10)
    assert sum(map(len, stream.take(0.5))) == 50
    assert sum(map(len, stream.take(1.0))) == 50


def test_one_seed_is_one_run():
    def dues(seed):
        stream, due = FaultyStream(seed), []
        stream.faults = StreamFaults(jitter_s=1.0)
        for _ in range(20):
            stream.put(0.0, b"x")
        while stream.next_s is not None:
            due.append(stream.next_s)
            stream.take(stream.next_s)
        return due

    assert dues(1) == dues(1) != dues(2)


@given(st.lists(st.binary(max_size=20)))
def test_split_lines_arrive_complete(chunks):
    lines = FaultyLines()
    for chunk in chunks:
        lines.put(0.0, chunk)
    whole, _, rest = b"".join(chunks).rpartition(b"\n")
    assert b"".join(lines.take(0.0)) == (whole + b"\n" if b"\n" in b"".join(chunks) else b"")
    assert lines.waiting_bytes == len(rest)


def test_lines_are_lost_and_duplicated_as_a_whole():
    lines = FaultyLines(seed=3)
    lines.faults = LinkFaults(drop=0.3, duplicate=0.3)
    sent = [f"{k}\n".encode() for k in range(1000)]
    lines.put(0.0, b"".join(sent))
    arrived = lines.take(0.0)
    assert set(arrived) < set(sent)
    assert 600 < len(set(arrived)) < 800
    assert len(arrived) > len(set(arrived)) + 100


def test_an_endless_line_does_not_fill_the_memory():
    lines = FaultyLines()
    for _ in range(5):
        lines.put(0.0, b"x" * (MAX_WAITING_BYTES // 2))
    assert lines.waiting_bytes < MAX_WAITING_BYTES
    assert sum(map(len, lines.take(0.0))) == 2 * MAX_WAITING_BYTES


def test_losses_in_a_byte_stream_are_refused():
    with pytest.raises(InvalidFaultError, match="loss does not apply to bytes, only to lines"):
        wire_faults(TrafficUnit.BYTES, {"drop": 0.1})
    with pytest.raises(InvalidFaultError, match="a stall does not apply to lines, only to bytes"):
        wire_faults(TrafficUnit.LINES, {"stalled": True})


def test_datagrams_over_tcp_are_refused():
    udp, tcp = Endpoint.parse("udp/127.0.0.1:1"), Endpoint.parse("tcp/127.0.0.1:1")
    with pytest.raises(InvalidEndpointError, match=r"tcp/127.0.0.1:1: datagrams travel over udp"):
        relay(udp, tcp, TrafficUnit.DATAGRAMS)
