"""Waits for a datagram, and tells whether it is the telegram that is expected, before Python runs again.

Python takes longer to wake up and to compare a telegram than the network takes to bring it. Here both are machine code:
`recvfrom`, the comparison, and a look whether more has come.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core.types import ExternalFunction
from numpy.typing import NDArray

from deltaq_cell.compiled import waits
from deltaq_protocol.arrays import Bytes, Indices
from deltaq_protocol.endpoint import Address
from deltaq_services.robot_server.expected_telegram import ExpectedTelegram, is_expected
from deltaq_services.robot_server.prepared_reply import Arrival

# functions of the C library, as their manual pages give them; a pointer is a number
_recvfrom: Any = ExternalFunction(
    "recvfrom", types.intp(types.intc, types.uintp, types.uintp, types.intc, types.uintp, types.uintp)
)
_poll: Any = ExternalFunction("poll", types.intc(types.uintp, types.uintp, types.intc))
_memcpy: Any = ExternalFunction("memcpy", types.uintp(types.uintp, types.uintp, types.uintp))
_place_of_errno: Any = ExternalFunction("__errno_location", types.uintp())

_ADDRESS_BYTES = 16
"""A `sockaddr_in`: family, port, host, padding."""
_TOLD_BYTES = 8
"""Of these family, port and host."""

_AGAIN, _INTERRUPTED = errno.EAGAIN, errno.EINTR


class _Room(NamedTuple):
    """What the kernel writes to.

    Attributes:
        datagram: (most bytes,) what came last.
        size: (1,) its bytes.
        sender, sender_size: (16,) and (1,) its sender.
        error: (1,) number of the last error.
        more: (8,) a `pollfd` that asks whether more has come.
    """

    datagram: Bytes
    size: Indices
    sender: Bytes
    sender_size: NDArray[np.uint32]
    error: NDArray[np.intc]
    more: Bytes


class TelegramWait:
    """Waits on one socket, for as long as its SO_RCVTIMEO says.

    Args:
        sock: UDP, IPv4.
        most_bytes: of a datagram that are kept.
    """

    def __init__(self, sock: socket.socket, most_bytes: int) -> None:
        self._descriptor = sock.fileno()
        more = struct.pack("=ihh", self._descriptor, select.POLLIN, 0)
        self._room = _Room(
            np.zeros(most_bytes, dtype=np.uint8),
            np.zeros(1, dtype=np.intp),
            np.zeros(_ADDRESS_BYTES, dtype=np.uint8),
            np.zeros(1, dtype=np.uint32),
            np.zeros(1, dtype=np.intc),
            np.frombuffer(bytearray(more), dtype=np.uint8),
        )
        self._peer: Address | None = None
        self._peer_bytes = np.zeros(_TOLD_BYTES, dtype=np.uint8)
        nothing = ExpectedTelegram.of(b"", (), np.zeros(0), np.zeros(0))
        self.rehearse(
            nothing, b"", ("127.0.0.1", 1)
        )  # machine code is made, or found, before there is a hurry

    def next(self, telegram: ExpectedTelegram, peer: Address) -> Arrival:
        """Wait for a datagram.

        Args:
            telegram: that is expected.
            peer: its sender.
        """
        self._expect_from(peer)
        return Arrival(_next(telegram, self._peer_bytes, self._room, self._descriptor, False))

    def rehearse(self, telegram: ExpectedTelegram, datagram: bytes, peer: Address) -> None:
        """Go through what follows when this datagram has come: right after it, caches are warm."""
        self._expect_from(peer)
        room = self._room
        room.datagram[: len(datagram)] = np.frombuffer(datagram, dtype=np.uint8)
        room.size[0] = len(datagram)
        room.sender[:_TOLD_BYTES] = self._peer_bytes
        _next(telegram, self._peer_bytes, room, self._descriptor, True)

    def taken(self) -> tuple[bytes, Address]:
        """The datagram that came last, and its sender."""
        room = self._room
        _, port, host = struct.unpack("!HH4s", room.sender[:_TOLD_BYTES].tobytes())
        return room.datagram[: room.size[0]].tobytes(), (socket.inet_ntoa(host), port)

    def _expect_from(self, peer: Address) -> None:
        if peer != self._peer:
            host, port = self._peer = peer
            told = struct.pack("=H", socket.AF_INET) + struct.pack("!H", port) + socket.inet_aton(host)
            self._peer_bytes[:] = np.frombuffer(told, dtype=np.uint8)


@waits
def _next(telegram: ExpectedTelegram, peer: Bytes, room: _Room, descriptor: int, is_rehearsal: bool) -> int:
    """An `Arrival`; in a rehearsal the datagram is in the room already."""
    if not is_rehearsal:
        room.sender_size[0] = _ADDRESS_BYTES
        size = _recvfrom(
            descriptor,
            room.datagram.ctypes.data,
            room.datagram.size,
            0,
            room.sender.ctypes.data,
            room.sender_size.ctypes.data,
        )
        if size < 0:
            _memcpy(room.error.ctypes.data, _place_of_errno(), room.error.itemsize)
            return Arrival.NOTHING if room.error[0] in (_AGAIN, _INTERRUPTED) else Arrival.ERROR
        room.size[0] = size
    for each in range(_TOLD_BYTES):
        if room.sender[each] != peer[each]:
            return Arrival.OTHER
    if not is_expected(telegram, room.datagram, room.size[0]):
        return Arrival.OTHER
    if _poll(room.more.ctypes.data, 1, 0) != 0:
        return Arrival.OTHER
    return Arrival.EXPECTED
