"""Waits for a telegram and answers it, if it is the expected one, before Python runs again.

Python takes longer to wake up, to compare a telegram and to send an answer than the network takes to bring it. So all
that lies between a telegram and its prepared reply is machine code: `ppoll`, `recvfrom`, the comparison, whether more
has come from the KRC or the gate, the guard, the record for the brake after a crash, and `sendto`.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core.types import ExternalFunction
from numpy.typing import NDArray

from deltaq_cell.compiled import makes_no_array, waits
from deltaq_protocol.arrays import Array, Bytes, Indices
from deltaq_protocol.endpoint import Address
from deltaq_services.robot_server.arrivals import Arrivals
from deltaq_services.robot_server.crash_brake.memory import OpenRecord
from deltaq_services.robot_server.crash_brake.record import NOTHING
from deltaq_services.robot_server.expected_telegram import ExpectedTelegram, is_expected
from deltaq_services.robot_server.last_steps import allows, continued_checksum
from deltaq_services.robot_server.prepared_reply import PreparedReply, TelegramOutcome
from deltaq_services.robot_server.reply_guard import ReplyBounds

# functions of the C library, as their manual pages give them; a pointer is a number
_recvfrom: Any = ExternalFunction(
    "recvfrom", types.intp(types.intc, types.uintp, types.uintp, types.intc, types.uintp, types.uintp)
)
_sendto: Any = ExternalFunction(
    "sendto", types.intp(types.intc, types.uintp, types.uintp, types.intc, types.uintp, types.uint32)
)
_ppoll: Any = ExternalFunction("ppoll", types.intc(types.uintp, types.uintp, types.uintp, types.uintp))
_clock_gettime: Any = ExternalFunction("clock_gettime", types.intc(types.intc, types.uintp))
_memcpy: Any = ExternalFunction("memcpy", types.uintp(types.uintp, types.uintp, types.uintp))
_place_of_errno: Any = ExternalFunction("__errno_location", types.uintp())

_ADDRESS_BYTES = 16
"""A `sockaddr_in`: family, port, host, padding."""
_TOLD_BYTES = 8
"""Of these family, port and host."""

_CLOCK = time.CLOCK_MONOTONIC
_NO_WAIT = socket.MSG_DONTWAIT
_NS_PER_S = 1_000_000_000
_REVENTS = 3
"""Where a `pollfd` of four short numbers says what has come."""
_AGAIN = errno.EAGAIN


class _Room(NamedTuple):
    """What the kernel reads and writes.

    Attributes:
        datagram: (most bytes,) what came last.
        size: (1,) its bytes.
        sender, sender_size: (16,) and (1,) its sender.
        waited: (2, 4) `pollfd`s of the socket and of what has come from the gate.
        timeout: (2,) how long to wait, in seconds and nanoseconds.
        clock: (2,) when the wait ended, likewise.
        came_s: (1,) the same [s].
        checksum: (1,) of the record.
        error: (1,) number of the last error.
    """

    datagram: Bytes
    size: Indices
    sender: Bytes
    sender_size: NDArray[np.uint32]
    waited: NDArray[np.int16]
    timeout: NDArray[np.int64]
    clock: NDArray[np.int64]
    came_s: Array
    checksum: NDArray[np.uint32]
    error: NDArray[np.intc]


class _Ready(NamedTuple):
    """A reply that is ready to be sent.

    Attributes:
        text: (m,) its bytes.
        correction, lower, upper: (n,) its correction, and between what the guard lets it pass [rad or m].
        record: (r,) left before the reply, as far as it is known before its telegram; empty if none is.
        checksum: of these bytes.
        number: (1,) of the record.
        place, sent_at: addresses in memory of the record, and of the number of the record whose reply was sent.
    """

    text: Bytes
    correction: Array
    lower: Array
    upper: Array
    record: Bytes
    checksum: int
    number: NDArray[np.uint64]
    place: int
    sent_at: int


class TelegramAnswer:
    """Waits on one socket.

    Args:
        sock: UDP, IPv4.
        most_bytes: of a datagram that are kept.
        arrivals: of the gate's messages.
    """

    def __init__(self, sock: socket.socket, most_bytes: int, arrivals: Arrivals) -> None:
        self._descriptor = sock.fileno()
        waited = b"".join(
            [struct.pack("=ihh", each, select.POLLIN, 0) for each in (self._descriptor, arrivals.descriptor)]
        )
        self._room = _Room(
            np.zeros(most_bytes, dtype=np.uint8),
            np.zeros(1, dtype=np.intp),
            np.zeros(_ADDRESS_BYTES, dtype=np.uint8),
            np.zeros(1, dtype=np.uint32),
            np.frombuffer(bytearray(waited), dtype=np.int16).reshape(2, -1),
            np.zeros(2, dtype=np.int64),
            np.zeros(2, dtype=np.int64),
            np.zeros(1),
            np.zeros(1, dtype=np.uint32),
            np.zeros(1, dtype=np.intc),
        )
        nothing = ExpectedTelegram.of(b"", (), np.zeros(0), np.zeros(0))
        # machine code is made, or found, before there is a hurry
        self.next(PreparedReply(nothing, (), b""), ReplyBounds((), ()), None, ("127.0.0.1", 1), 0.0, 0.0)

    @property
    def came_s(self) -> float:
        """When the last wait ended, on the monotonic clock."""
        return float(self._room.came_s[0])

    def next(
        self,
        prepared: PreparedReply,
        bounds: ReplyBounds,
        record: OpenRecord | None,
        peer: Address,
        rehearse_in_s: float,
        seconds: float,
    ) -> TelegramOutcome:
        """Wait for a datagram, and answer it if it is the expected telegram.

        Args:
            prepared: the reply.
            bounds: the guard's, of its correction.
            record: to leave before it; None if none is.
            peer: the telegram's sender.
            rehearse_in_s: after which time without a datagram all is gone through once but for the answer; right after
                it, caches are warm.
            seconds: to wait altogether.
        """
        left = record or OpenRecord(number=NOTHING, begins=b"", checksum=0, address=0, sent_address=0)
        ready = _Ready(
            np.frombuffer(prepared.reply, dtype=np.uint8),
            np.array(prepared.correction),
            np.array(bounds.lower),
            np.array(bounds.upper),
            np.frombuffer(left.begins, dtype=np.uint8),
            left.checksum,
            np.array([left.number], dtype=np.uint64),
            left.address,
            left.sent_address,
        )
        first_s = min(max(rehearse_in_s, 0.0), seconds)
        host, port = peer
        told = struct.pack("=H", socket.AF_INET) + struct.pack("!H", port) + socket.inet_aton(host)
        sender = np.frombuffer(told, dtype=np.uint8)
        return TelegramOutcome(
            _next(prepared.telegram, sender, ready, self._room, self._descriptor, first_s, seconds - first_s)
        )

    def taken(self) -> tuple[bytes, Address]:
        """The datagram that came last, and its sender."""
        room = self._room
        _, port, host = struct.unpack("!HH4s", room.sender[:_TOLD_BYTES].tobytes())
        return room.datagram[: room.size[0]].tobytes(), (socket.inet_ntoa(host), port)


@waits
def _next(
    telegram: ExpectedTelegram,
    peer: Bytes,
    ready: _Ready,
    room: _Room,
    descriptor: int,
    first_s: float,
    then_s: float,
) -> int:
    """A `TelegramOutcome`."""
    come = _waited(room, first_s)
    if come == 0:
        _rehearse(telegram, peer, ready, room)
        come = _waited(room, then_s)
    size = -1
    if come > 0 and room.waited[0, _REVENTS]:
        room.sender_size[0] = _ADDRESS_BYTES
        size = _recvfrom(
            descriptor,
            room.datagram.ctypes.data,
            room.datagram.size,
            _NO_WAIT,
            room.sender.ctypes.data,
            room.sender_size.ctypes.data,
        )
    _memcpy(room.error.ctypes.data, _place_of_errno(), room.error.itemsize)
    _clock_gettime(_CLOCK, room.clock.ctypes.data)
    room.came_s[0] = (room.clock[0] * _NS_PER_S + room.clock[1]) / 1e9
    room.size[0] = size
    if size < 0:
        if come > 0 and room.waited[0, _REVENTS]:
            return TelegramOutcome.NOTHING if room.error[0] == _AGAIN else TelegramOutcome.ERROR
        return TelegramOutcome.NEWS if come > 0 else TelegramOutcome.NOTHING
    if not _is_due(telegram, peer, ready, room):
        return TelegramOutcome.OTHER
    if ready.record.size > 0:
        _seal(ready, room)
        # as `BegunRecord.sealed`: checksum, what was begun, time
        place = ready.place
        _memcpy(place, room.checksum.ctypes.data, room.checksum.itemsize)
        place += room.checksum.itemsize
        _memcpy(place, ready.record.ctypes.data, ready.record.size)
        _memcpy(place + ready.record.size, room.came_s.ctypes.data, room.came_s.itemsize)
    sent = _sendto(
        descriptor, ready.text.ctypes.data, ready.text.size, 0, room.sender.ctypes.data, _ADDRESS_BYTES
    )
    if ready.record.size > 0:
        _memcpy(ready.sent_at, ready.number.ctypes.data, ready.number.itemsize)
    return TelegramOutcome.ANSWERED if sent == ready.text.size else TelegramOutcome.UNSENT


@makes_no_array
def _waited(room: _Room, seconds: float) -> int:
    """As `ppoll`: how many of both have something to read, zero if the time is over, less for a signal."""
    nanoseconds = round(seconds * 1e9)
    room.timeout[0], room.timeout[1] = nanoseconds // _NS_PER_S, nanoseconds % _NS_PER_S
    return int(_ppoll(room.waited.ctypes.data, len(room.waited), room.timeout.ctypes.data, 0))


@makes_no_array
def _rehearse(telegram: ExpectedTelegram, peer: Bytes, ready: _Ready, room: _Room) -> None:
    """Look at the expected telegram as if it had come."""
    room.size[0] = min(telegram.text.size, room.datagram.size)
    for each in range(room.size[0]):
        room.datagram[each] = telegram.text[each]
    for each in range(peer.size):
        room.sender[each] = peer[each]
    _is_due(telegram, peer, ready, room)
    _seal(ready, room)


@makes_no_array
def _is_due(telegram: ExpectedTelegram, peer: Bytes, ready: _Ready, room: _Room) -> bool:
    """Whether the datagram is to be answered; the guard is asked last of all."""
    for each in range(peer.size):
        if room.sender[each] != peer[each]:
            return False
    if not is_expected(telegram, room.datagram, room.size[0]) or _waited(room, 0.0) != 0:
        return False
    return allows(ready.correction, ready.lower, ready.upper)


@makes_no_array
def _seal(ready: _Ready, room: _Room) -> None:
    """Sum up the record with the time at which its telegram came."""
    room.checksum[0] = continued_checksum(ready.checksum, room.came_s.view(np.uint8))
