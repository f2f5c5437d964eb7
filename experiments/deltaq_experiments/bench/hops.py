"""What hops.c does, for machines without a C compiler: five hops of one message through four processes, once a cycle.

`python -m deltaq_experiments.bench.hops CYCLE_NS CYCLES BYTES FILE`; hops.c says what FILE gets.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Never

import numpy as np

STAMPS = 6
_HEAD = struct.Struct(f"={1 + STAMPS}q")
_NICENESS = -10


def main(cycle_ns: int, cycles: int, size: int, file: Path) -> None:
    """Send a message a cycle around, and write when each hop had it."""
    links = [_connected() for _ in range(5)]  # link i carries hop i + 1
    sources, sinks = [link[0] for link in links], [link[1] for link in links]
    _between(links, 9, [(sinks[0], sources[1], 1), (sinks[2], sources[3], 3)], size)
    _between(links, 0, [(sinks[1], sources[2], 2)], size)
    _between(links, 10, [(sinks[3], sources[4], 4)], size)
    out, back = sources[0], sinks[4]
    _close_all_but(links, {out, back})
    _ask_for(20)
    rows = np.zeros((cycles, STAMPS), dtype=np.int64)
    poll = select.poll()
    poll.register(back, select.POLLIN)
    due_ns = time.monotonic_ns()
    for cycle in range(cycles + 1):  # one more than are sent, for the last one to come back in
        if cycle < cycles:
            rows[cycle, 0] = now_ns = time.monotonic_ns()
            out.sendall(_HEAD.pack(cycle, now_ns, 0, 0, 0, 0, 0).ljust(size, b"\0"))
        due_ns += cycle_ns
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            if not poll.poll(left_ns / 1e6):
                continue
            number, *stamps = _HEAD.unpack_from(_received(back, size))
            rows[number] = [*stamps[:5], time.monotonic_ns()]
    file.write_bytes(rows.tobytes())
    out.close()  # the others end one after the other
    with suppress(ChildProcessError):
        while True:
            os.wait()


def _between(
    links: list[tuple[socket.socket, socket.socket]],
    priority: int,
    inputs: list[tuple[socket.socket, socket.socket, int]],
    size: int,
) -> None:
    """Start a process that hands on what comes: from a socket, to a socket, as which hop."""
    if os.fork():
        return
    status = 1
    try:
        _close_all_but(links, {end for source, sink, _ in inputs for end in (source, sink)})
        _ask_for(priority)
        _hand_on(inputs, size)
    except (EOFError, OSError):
        status = 0  # the one before or the one after has ended
    finally:
        os._exit(status)


def _hand_on(inputs: list[tuple[socket.socket, socket.socket, int]], size: int) -> Never:
    poll = select.poll()
    by_descriptor = {source.fileno(): (source, sink, hop) for source, sink, hop in inputs}
    for descriptor in by_descriptor:
        poll.register(descriptor, select.POLLIN)
    while True:
        for descriptor, _ in poll.poll():
            source, sink, hop = by_descriptor[descriptor]
            message = _received(source, size)
            struct.pack_into("=q", message, 8 * (1 + hop), time.monotonic_ns())
            sink.sendall(message)


def _received(source: socket.socket, size: int) -> bytearray:
    message, have = bytearray(size), 0
    view = memoryview(message)
    while have < size:
        count = source.recv_into(view[have:])
        if count == 0:
            raise EOFError
        have += count
    return message


def _connected() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        one = socket.create_connection(listener.getsockname())
        other, _ = listener.accept()
    for end in (one, other):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return one, other


def _close_all_but(links: list[tuple[socket.socket, socket.socket]], kept: set[socket.socket]) -> None:
    for link in links:
        for end in link:
            if end not in kept:
                end.close()


def _ask_for(priority: int) -> None:
    """SCHED_FIFO if positive and allowed, else the nice value of the launcher's processes."""
    if priority > 0:
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            return
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
