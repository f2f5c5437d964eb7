"""Connections that wait to be taken up: stops first, then who has said something, and nobody for ever."""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import AsyncIterator, Iterator

import pytest

from deltaq_services.hli import newcomers
from deltaq_services.hli.newcomers import Newcomers
from deltaq_services.hli.places import MAX_WAITING
from deltaq_testing.private_cell import free_ports

STOP = b'{"type":"stop"}\n'
HELLO = b'{"type":"hello","protocol":1,"client":"x"}\n'


class Taken(asyncio.Protocol):
    """One that was taken up, and what it read."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._bench.transports.append(transport)
        self._bench.ports.append(transport.get_extra_info("peername")[1])

    def data_received(self, data: bytes) -> None:
        self._bench.read += data


class Bench:
    """Who listens, who has been taken up, and who connects."""

    per_second = 256.0

    def __init__(self) -> None:
        self.port = free_ports(1)[0]
        self.counters: Counter[str] = Counter()
        self.ports: list[int] = []
        self.begun_for_stops = 0
        self.transports: list[asyncio.BaseTransport] = []
        self.read = b""
        self.clients: list[socket.socket] = []
        loop = asyncio.get_running_loop()
        self.newcomers = Newcomers(loop, self._begin, self.counters, self.per_second)

    def _begin(self, brings_stop: bool) -> Taken:
        self.begun_for_stops += brings_stop
        return Taken(self)

    def connected(self, says: bytes = b"") -> socket.socket:
        client = socket.create_connection(("127.0.0.1", self.port))
        self.clients.append(client)
        client.sendall(says)
        return client

    async def taken(self, client: socket.socket) -> None:
        """Wait until a client has been taken up."""
        async with asyncio.timeout(300):
            while client.getsockname()[1] not in self.ports:
                await asyncio.sleep(0)

    async def let_in(self, count: int) -> None:
        """Wait until so many have been let in, whatever became of them."""
        async with asyncio.timeout(300):
            while len(self.ports) + len(self.newcomers._waiting) + self.counters.total() < count:
                await asyncio.sleep(0)


@pytest.fixture
def none_without_a_stop(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As when so many have been taken up that the others have to wait."""
    monkeypatch.setattr(Bench, "per_second", 0.5)
    return


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    bench = Bench()
    await bench.newcomers.listen("127.0.0.1", bench.port)
    yield bench
    await bench.newcomers.close()
    for transport in bench.transports:
        transport.close()
    for client in bench.clients:
        client.close()


async def test_a_connection_is_accepted_with_all_earlier_data(bench: Bench) -> None:
    await bench.taken(bench.connected(HELLO + STOP))
    async with asyncio.timeout(300):
        while bench.read != HELLO + STOP:
            await asyncio.sleep(0)
    assert bench.begun_for_stops == 1


async def test_a_connection_without_a_stop_gets_no_priority(bench: Bench) -> None:
    await bench.taken(bench.connected(HELLO))
    assert bench.begun_for_stops == 0


async def test_a_silent_connection_is_accepted_too(bench: Bench) -> None:
    await bench.taken(bench.connected())


@pytest.mark.usefixtures("none_without_a_stop")
async def test_a_stop_is_accepted_before_all_waiting_connections(bench: Bench) -> None:
    for says in (b"", HELLO) * 20:
        bench.connected(says)
    await bench.let_in(40)
    stop = bench.connected(HELLO + STOP)
    await bench.taken(stop)
    assert len(bench.ports) == bench.begun_for_stops == 1


@pytest.mark.usefixtures("none_without_a_stop")
async def test_a_later_stop_is_accepted(bench: Bench) -> None:
    client = bench.connected()
    await bench.let_in(1)
    for _ in range(10):
        await asyncio.sleep(0)
    client.sendall(STOP)
    await bench.taken(client)


@pytest.mark.usefixtures("none_without_a_stop")
async def test_a_lookalike_of_a_stop_is_not_accepted_before_others(bench: Bench) -> None:
    bench.connected(b'{"stop":1}\n')
    bench.connected(b'"stop"')
    await bench.let_in(2)
    for _ in range(100):
        await asyncio.sleep(0)
    assert not bench.ports


async def test_silent_connections_that_may_still_stop_are_awaited(bench: Bench) -> None:
    bench.newcomers._silent_s = 300.0
    silent = bench.connected()
    await bench.taken(bench.connected(HELLO))
    assert len(bench.ports) == 1
    silent.sendall(STOP)
    await bench.taken(silent)
    assert bench.begun_for_stops == 1


async def test_connections_that_have_sent_data_are_accepted_before_silent_ones(
    monkeypatch: pytest.MonkeyPatch, bench: Bench
) -> None:
    monkeypatch.setattr(newcomers, "_LET_IN_A_TURN", 2)
    monkeypatch.setattr(newcomers, "_TAKEN_UP_A_TURN", 1)
    spoken, silent = bench.connected(HELLO), bench.connected()
    await bench.taken(silent)
    await bench.taken(spoken)
    assert bench.ports == [client.getsockname()[1] for client in (spoken, silent)]


@pytest.mark.usefixtures("none_without_a_stop")
async def test_of_too_many_connections_the_oldest_is_closed(bench: Bench) -> None:
    first = bench.connected()
    for _ in range(MAX_WAITING):
        bench.connected()
    await bench.let_in(MAX_WAITING + 1)
    assert bench.counters == {"tcp_connections_given_way": 1}
    first.settimeout(300.0)
    assert await asyncio.to_thread(first.recv, 1) == b""


@pytest.mark.usefixtures("none_without_a_stop")
async def test_a_disconnected_newcomer_leaves_no_trace(bench: Bench) -> None:
    for _ in range(20):
        bench.connected().close()
    async with asyncio.timeout(300):
        stop = bench.connected(STOP)
        await bench.taken(stop)
        while len(bench.newcomers._waiting):
            await asyncio.sleep(0)
    assert not bench.newcomers._silent
    assert not bench.newcomers._let_in_s
    assert not bench.newcomers._spoken


@pytest.mark.usefixtures("none_without_a_stop")
async def test_waiting_connections_are_closed_at_the_end(bench: Bench) -> None:
    silent, spoken = bench.connected(), bench.connected(HELLO)
    await bench.let_in(2)
    await bench.newcomers.close()
    for client in (silent, spoken):
        client.settimeout(300.0)
        try:
            assert await asyncio.to_thread(client.recv, 1) == b""
        except ConnectionResetError:  # it had said something that nobody read
            assert client is spoken


async def test_an_error_of_the_system_is_logged_and_survived(
    monkeypatch: pytest.MonkeyPatch, bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(newcomers, "_REST_S", 0.001)
    (listener,) = bench.newcomers._listeners

    class Exhausted:
        """Has no descriptor left, once."""

        fileno, close = listener.fileno, listener.close
        failed = False

        def accept(self) -> tuple[socket.socket, tuple[str, int]]:
            if not self.failed:
                self.failed = True
                raise OSError(24, "Too many open files")
            return listener.accept()

    exhausted = Exhausted()
    monkeypatch.setattr(bench.newcomers, "_listeners", [exhausted])
    bench.newcomers._let_in(exhausted)
    assert caplog.messages == ["no connection can be accepted: [Errno 24] Too many open files"]
    await bench.taken(bench.connected())
