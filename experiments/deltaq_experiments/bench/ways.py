"""Ways of a message into a process and out of it again, each beside a bare socket: why the services take theirs.

`python -m deltaq_experiments.bench.ways`. Another process answers each message at once, in one of several ways; a
message is as large as a robot's state and comes once in 4 ms, so that caches are as cold as in a running cell.
"""

from __future__ import annotations

import argparse
import asyncio
import queue
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from typing import Any

import zenoh
from zenoh.shm import ShmProvider

from deltaq_experiments.bench.hop_reference import MESSAGE_BYTES
from deltaq_experiments.bench.table import BenchRow, BenchTable
from deltaq_launch.private_cell import free_ports
from deltaq_launch.program import run_program
from deltaq_protocol.served_in_loop import ServedInLoop
from deltaq_protocol.session import declare_publisher, open_session

CYCLE_S = 0.004
CYCLES = 1000
_LEFT_OUT = 50
"""Cycles of the beginning."""
_ANSWERS_WITHIN_S = 10.0
_THERE, _BACK = "deltaq-bench/there", "deltaq-bench/back"
_SHARED_BYTES = 1 << 20


class MessageWay(StrEnum):
    """How another process hears a message, and who answers."""

    SOCKET = "a bare socket"
    ZENOH_THREAD = "zenoh's thread"
    WAITING_THREAD = "a waiting thread"
    LOOP = "asyncio"
    TWO_SESSIONS = "asyncio, two sessions"
    SHARED_MEMORY = "shared memory"


EXPLAINED = {
    MessageWay.SOCKET: "the thread that reads it answers",
    MessageWay.ZENOH_THREAD: "zenoh's own thread answers",
    MessageWay.WAITING_THREAD: "a thread answers that waits for zenoh's",
    MessageWay.LOOP: "the event loop answers, as in the services",
    MessageWay.TWO_SESSIONS: "the same, and the answer leaves over a session of its own, as in the HLI",
    MessageWay.SHARED_MEMORY: "zenoh's own thread answers, and messages lie in memory that both processes have",
}


def ways(cycles: int = CYCLES) -> BenchTable:
    """Time from a message to its answer for every way, each beside the bare socket; the ways take turns.

    Args:
        cycles: messages of each way.
    """
    took: dict[MessageWay, list[float]] = {way: [] for way in MessageWay}
    with ExitStack() as answering:
        asks = {way: answering.enter_context(_answering(way)) for way in MessageWay}
        due_s = time.monotonic()
        for way in [way for _ in range(_LEFT_OUT + cycles) for way in MessageWay]:
            due_s = max(due_s + CYCLE_S, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
            begin_s = time.perf_counter()
            asks[way](bytes(MESSAGE_BYTES))
            took[way].append(time.perf_counter() - begin_s)
    bare, *others = MessageWay
    return BenchTable(
        rows=tuple(
            BenchRow.of(
                way,
                bare,
                took[way][_LEFT_OUT:],
                took[bare][_LEFT_OUT:],
                no_bound_because="it tells why the services take their way, and promises nothing",
            )
            for way in others
        )
    )


@contextmanager
def _answering(way: MessageWay) -> Iterator[Callable[[bytes], None]]:
    """A process that answers in some way; gives a function that asks it, and returns with its answer."""
    ports = free_ports(2)
    command = [sys.executable, "-m", "deltaq_experiments.bench.ways", "--answer", way]
    process = subprocess.Popen([*command, *map(str, ports)], stdout=subprocess.PIPE, stdin=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()  # it listens
        with _asking_socket(ports[0]) if way is MessageWay.SOCKET else _asking_zenoh(way, ports) as ask:
            yield ask
    finally:
        process.kill()
        process.communicate()


@contextmanager
def _asking_socket(port: int) -> Iterator[Callable[[bytes], None]]:
    with socket.create_connection(("127.0.0.1", port)) as line:
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def ask(message: bytes) -> None:
            line.sendall(message)
            _receive(line)

        yield ask


@contextmanager
def _asking_zenoh(way: MessageWay, ports: list[int]) -> Iterator[Callable[[bytes], None]]:
    session = open_session(connect=[f"tcp/127.0.0.1:{port}" for port in ports[: _sessions(way)]])
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    subscriber = session.declare_subscriber(
        _BACK, _called(lambda sample: answers.put(sample.payload.to_bytes()))
    )
    publisher = declare_publisher(session, _THERE)
    put = _shared(publisher) if way is MessageWay.SHARED_MEMORY else publisher.put

    def ask(message: bytes) -> None:
        put(message)
        answers.get(timeout=_ANSWERS_WITHIN_S)

    try:
        while True:  # until both have found one another what is published reaches nobody
            put(bytes(MESSAGE_BYTES))
            try:
                answers.get(timeout=0.1)
                break
            except queue.Empty:
                continue
        yield ask
    finally:
        subscriber.undeclare()
        session.close()


def _called(put: Callable[[zenoh.Sample], None]) -> Any:
    return zenoh.handlers.Callback(put, indirect=False)


def _sessions(way: MessageWay) -> int:
    return 2 if way is MessageWay.TWO_SESSIONS else 1


def _shared(publisher: Any) -> Callable[[bytes], None]:
    """Publishes what is put as memory that is shared."""
    memory = ShmProvider.default_backend(_SHARED_BYTES)

    def put(message: bytes) -> None:
        memory.garbage_collect()
        here = memory.alloc(len(message))
        here[:] = message
        publisher.put(here)

    return put


def _receive(line: socket.socket) -> bytes:
    message = b""
    while len(message) < MESSAGE_BYTES:
        more = line.recv(MESSAGE_BYTES - len(message))
        if not more:
            raise EOFError
        message += more
    return message


def _answer(way: MessageWay, ports: list[int]) -> None:
    """Answer until killed."""
    if way is MessageWay.SOCKET:
        with socket.create_server(("127.0.0.1", ports[0])) as listener:
            print("ready", flush=True)
            line, _ = listener.accept()
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while True:
                line.sendall(_receive(line))
    sessions = [open_session(listen=[f"tcp/127.0.0.1:{port}"]) for port in ports[: _sessions(way)]]
    publisher = declare_publisher(sessions[-1], _BACK)
    if way in (MessageWay.LOOP, MessageWay.TWO_SESSIONS):
        asyncio.run(_answer_in_loop(sessions[0], publisher))
    elif way is MessageWay.WAITING_THREAD:
        arriving = sessions[0].declare_subscriber(_THERE, zenoh.handlers.FifoChannel(16))
        print("ready", flush=True)
        while True:
            publisher.put(arriving.recv().payload.to_bytes())
    else:
        put = _shared(publisher) if way is MessageWay.SHARED_MEMORY else publisher.put
        kept = sessions[0].declare_subscriber(_THERE, _called(lambda sample: put(sample.payload.to_bytes())))
        print("ready", flush=True)
        sys.stdin.read()
        kept.undeclare()


async def _answer_in_loop(session: Any, publisher: Any) -> None:
    served = ServedInLoop(session, asyncio.get_running_loop())

    def answer(sample: zenoh.Sample) -> None:
        publisher.put(sample.payload.to_bytes())

    inbox = served.inbox(answer, capacity=16)
    served.subscribe(_THERE, inbox.put)
    print("ready", flush=True)
    await asyncio.Event().wait()


def main() -> None:
    """Measure all ways, or answer in one."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_experiments.bench.ways", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--cycles", type=int, default=CYCLES, help="messages of each way")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--answer", nargs=3, metavar=("WAY", "PORT", "PORT"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.answer:
        way, *ports = given.answer
        _answer(MessageWay(way), [int(port) for port in ports])
        return
    if given.cycles < 1:
        parser.error(f"--cycles {given.cycles}: at least 1")
    found = ways(given.cycles)
    if given.json:
        print(found.model_dump_json())
        return
    print(f"{'':24}{'median us':>12}{'x socket':>10}{'p99 x':>8}")
    for row in found.rows:
        print(f"{row.what:24}{row.median_us:12.0f}{row.median_ratio:10.1f}{row.p99_ratio:8.1f}")
    print(f"{found.rows[0].reference:24}{found.rows[0].reference_us:12.0f}")
    for way, what in EXPLAINED.items():
        print(f"{way}: {what}")


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.bench.ways")
