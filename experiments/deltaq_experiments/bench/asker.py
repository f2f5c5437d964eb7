"""What asker.c does, for machines without a C compiler.

`python -m deltaq_experiments.bench.asker CYCLE_NS ADDRESS PORT TELEGRAMS FILE`; asker.c says what the files hold.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Never

_LENGTH = struct.Struct("=I")
_ROW = struct.Struct("=2q")
_DATAGRAM_BYTES = 65_536
_ECHO_PRIORITY, _ASKER_PRIORITY = 29, 30


def main(cycle_ns: int, server: tuple[str, int], telegrams: Path, file: Path) -> None:
    """Send all telegrams, one a cycle, to the Robot Server and to an echo, and write how long each took."""
    to_server, to_echo, of_echo = _bound(), _bound(), _bound()
    child = os.fork()
    if child == 0:
        _echo(of_echo)
    try:
        _ask_for(_ASKER_PRIORITY)
        rows = []
        due_ns = time.monotonic_ns()
        for telegram in framed(telegrams.read_bytes()):
            first = _asked(to_server, server, telegram, due_ns + cycle_ns // 4 * 3)
            due_ns += cycle_ns
            rows.append(_ROW.pack(first, _asked(to_echo, of_echo.getsockname(), telegram, due_ns)))
        file.write_bytes(b"".join(rows))
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def framed(data: bytes) -> Iterator[bytes]:
    """Datagrams, each behind its length in 32 bits."""
    place = 0
    while place < len(data):
        (length,) = _LENGTH.unpack_from(data, place)
        place += _LENGTH.size + length
        yield data[place - length : place]


def frame(datagrams: list[bytes]) -> bytes:
    """The reverse of `framed`."""
    return b"".join(_LENGTH.pack(len(datagram)) + datagram for datagram in datagrams)


def _asked(own: socket.socket, whom: tuple[str, int], telegram: bytes, until_ns: int) -> int:
    """How long an answer took, -1 if none came by `until_ns`; returns at that time in any case.

    An answer that comes later is taken for one to the next telegram: it does not say which it answers.
    """
    took_ns, sent_ns = -1, time.monotonic_ns()
    poll = select.poll()
    poll.register(own, select.POLLIN)
    own.sendto(telegram, whom)
    while (left_ns := until_ns - time.monotonic_ns()) > 0:
        if poll.poll(left_ns / 1e6):
            with suppress(BlockingIOError, ConnectionError):
                own.recv(_DATAGRAM_BYTES)
                if took_ns < 0:
                    took_ns = time.monotonic_ns() - sent_ns
    return took_ns


def _echo(own: socket.socket) -> Never:
    _ask_for(_ECHO_PRIORITY)
    own.setblocking(True)
    while True:
        own.sendto(*own.recvfrom(_DATAGRAM_BYTES))


def _bound() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.setblocking(False)
    return made


def _ask_for(priority: int) -> None:
    with suppress(PermissionError):  # the Robot Server has none either
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


if __name__ == "__main__":
    main(int(sys.argv[1]), (sys.argv[2], int(sys.argv[3])), Path(sys.argv[4]), Path(sys.argv[5]))
