"""Bytes of a TCP connection, without a connection: lines come out as they came, and stops before their turn."""

import pytest

from deltaq_services.hli.line_requests import MAX_LINE_BYTES, ReceivedLines

STOP = b'{"type":"stop"}'


def received(*parts: bytes) -> ReceivedLines:
    lines = ReceivedLines()
    for part in parts:
        lines.add(part)
    return lines


@pytest.mark.parametrize(
    "other",
    [
        b'{"type":"hello","client":"\\"stop\\""}\n',
        b'{"type":"stops"}\n',
        b'["stop"]\n',
        b'{"type":"stop"\n',
        STOP,
        STOP[:-1] + b" " * MAX_LINE_BYTES + b"}\n",
    ],
)
def test_an_incomplete_stop_stays_unread(other: bytes) -> None:
    lines = received(other)
    assert not lines.take_stop(0)
    assert len(lines) == len(other)


def test_a_stop_overtakes_waiting_lines_and_keeps_them() -> None:
    lines = received(b"first\n", b"sec")
    begin = len(lines)
    lines.add(b"ond\n" + STOP + b"\nthird")
    assert lines.take_stop(begin)
    assert [lines.take(), lines.take(), lines.take()] == [b"first", b"second", None]
    lines.add(b"\n")
    assert lines.take() == b"third"


def test_a_stop_received_byte_by_byte_is_recognised_at_its_last_byte() -> None:
    lines = received(b"waits\n")
    seen = []
    for byte in STOP + b"\n":
        begin = len(lines)
        lines.add(bytes([byte]))
        seen.append(lines.take_stop(begin))
    assert seen == [False] * len(STOP) + [True]


def test_the_length_of_a_line_is_known_before_its_end() -> None:
    lines = received(b"begun")
    assert lines.first() == (5, False)
    lines.add(b" and ended\nnext")
    assert lines.first() == (15, True)


def test_after_dropped_lines_the_incomplete_last_one_continues() -> None:
    lines = received(b"a\nb\nc")
    assert lines.first() == (1, True)
    lines.forget_whole()
    lines.add(b"d\n")
    assert lines.take() == b"cd"
