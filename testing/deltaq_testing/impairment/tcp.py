"""Faults of a byte stream, and a relay that impairs TCP connections and those of Unix sockets."""

import asyncio
import contextlib
import random
from collections import deque
from collections.abc import Callable
from typing import Annotated, Any, Protocol, Self

from pydantic import BaseModel, ConfigDict, Field

from deltaq_emulator.faults import Seconds
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import ServiceUnreachableError

MAX_WAITING_BYTES = 1024 * 1024
"""Bytes that wait in one direction; beyond, no more are read from the sender."""


class StreamFaults(BaseModel):
    """Faults of the bytes of a connection in one direction; none by default."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    delay_s: Seconds = 0.0
    """Their delay."""
    jitter_s: Seconds = 0.0
    """Their largest additional delay, uniformly distributed; none overtakes another."""
    rate_bytes_s: Annotated[float, Field(gt=0)] | None = None
    """Bytes per second; None for no limit."""
    stalled: bool = False
    """Nothing passes and nothing is lost, as when a cable is pulled: all of it arrives once this ends."""
    cut: bool = False
    """Connections are broken, and new ones refused."""


class FaultyStream:
    """One direction of a connection.

    Args:
        seed: of the random delays.

    Attributes:
        faults: may be set at any time.
        waiting_bytes: bytes that have entered and not left.
    """

    def __init__(self, seed: int = 0) -> None:
        self.faults = StreamFaults()
        self.waiting_bytes = 0
        self._random = random.Random(seed)
        self._queue: deque[tuple[float, bytes]] = deque()
        self._last_due_s = 0.0

    def put(self, now_s: float, chunk: bytes) -> None:
        """Bytes enter the stream."""
        faults = self.faults
        due_s = max(self._last_due_s, now_s + faults.delay_s + self._random.random() * faults.jitter_s)
        if faults.rate_bytes_s is not None:
            due_s += len(chunk) / faults.rate_bytes_s
        self._last_due_s = due_s
        self._queue.append((due_s, chunk))
        self.waiting_bytes += len(chunk)

    def take(self, now_s: float) -> list[bytes]:
        """The chunks that leave the stream by now, in order."""
        out: list[bytes] = []
        while not self.faults.stalled and self._queue and self._queue[0][0] <= now_s:
            out.append(self._queue.popleft()[1])
        self.waiting_bytes -= sum(map(len, out))
        return out

    @property
    def next_s(self) -> float | None:
        """Time at which the next bytes leave [s]; None if none wait, or the stream is stalled."""
        return self._queue[0][0] if self._queue and not self.faults.stalled else None


_CHUNK_BYTES = 64 * 1024


class Direction(Protocol):
    """Faults of bytes in one direction: `FaultyStream` or `FaultyLines`."""

    faults: Any

    @property
    def waiting_bytes(self) -> int:
        """Bytes that have entered and not left."""

    @property
    def next_s(self) -> float | None:
        """When the next bytes leave, or None."""

    def put(self, now_s: float, chunk: bytes) -> None:
        """Bytes enter."""

    def take(self, now_s: float) -> list[bytes]:
        """The chunks that leave by now."""


class TcpRelay:
    """Accepts connections and relays them to another address; an async context manager.

    Args:
        listen: address at which it accepts them.
        to: address to which it relays them.
        new_direction: makes one direction of a connection from its seed.
        seed: of the first; each direction has its own.

    Raises:
        ServiceUnreachableError: on entering, if `listen` cannot be listened on.
    """

    def __init__(
        self, listen: Endpoint, to: Endpoint, new_direction: Callable[[int], Direction], seed: int = 0
    ) -> None:
        self._listen, self._to = listen, to
        self._new_direction, self._seed = new_direction, seed
        self._faults = new_direction(seed).faults
        self._carriers: set[_Carrier] = set()
        self._connections: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        try:
            if self._listen.transport == "unixsock-stream":
                self._server = await asyncio.start_unix_server(self._serve, self._listen.host)
            else:
                self._server = await asyncio.start_server(self._serve, *self._listen.address)
        except OSError as error:
            raise ServiceUnreachableError(
                f"cannot listen on {self._listen}: {error.strerror}; name an address of this machine that is free"
            ) from error
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for connection in tuple(self._connections):
            connection.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)
        await self._server.wait_closed()

    def impair(self, faults: Any) -> None:
        """Set the faults from now on, in present and in new connections."""
        self._faults = faults
        for carrier in tuple(self._carriers):
            carrier.impair(faults)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection = asyncio.current_task()
        assert connection is not None  # a server serves each connection in a task
        self._connections.add(connection)
        try:
            if not _is_cut(self._faults):
                await self._carry(reader, writer)
        except (OSError, asyncio.CancelledError):
            pass  # one end is gone or was never there, or the relay ends: `abort` tells the other end
        finally:
            writer.transport.abort()
            self._connections.discard(connection)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._to.transport == "unixsock-stream":
            onward_reader, onward_writer = await asyncio.open_unix_connection(self._to.host)
        else:
            onward_reader, onward_writer = await asyncio.open_connection(*self._to.address)
        pair = (
            _Carrier(self._next_direction(), reader, onward_writer),
            _Carrier(self._next_direction(), onward_reader, writer),
        )
        self._carriers.update(pair)
        tasks = [asyncio.create_task(carrier.carry()) for carrier in pair]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            self._carriers.difference_update(pair)
            onward_writer.transport.abort()

    def _next_direction(self) -> Direction:
        direction = self._new_direction(self._seed)
        direction.faults = self._faults
        self._seed += 1
        return direction


class _Carrier:
    """One direction of one connection, at work."""

    def __init__(
        self, direction: Direction, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._direction, self._reader, self._writer = direction, reader, writer
        self._changed, self._has_room = asyncio.Event(), asyncio.Event()
        self._ended = False

    def impair(self, faults: Any) -> None:
        """Do this from now on."""
        self._direction.faults = faults
        self._changed.set()
        if _is_cut(faults):
            self._writer.transport.abort()

    async def carry(self) -> None:
        """Carry until the sender has ended and everything has arrived."""
        filling = asyncio.create_task(self._fill())
        try:
            await self._empty()
        finally:
            filling.cancel()
            with contextlib.suppress(asyncio.CancelledError, OSError):
                await filling

    async def _fill(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            while chunk := await self._reader.read(_CHUNK_BYTES):
                self._direction.put(loop.time(), chunk)
                self._changed.set()
                while self._direction.waiting_bytes > MAX_WAITING_BYTES:
                    self._has_room.clear()
                    await self._has_room.wait()
        finally:
            self._ended = True
            self._changed.set()

    async def _empty(self) -> None:
        loop, direction = asyncio.get_running_loop(), self._direction
        while True:
            self._changed.clear()
            self._writer.write(b"".join(direction.take(loop.time())))
            self._has_room.set()
            await self._writer.drain()
            if self._ended and direction.next_s is None and not direction.waiting_bytes:
                break
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(direction.next_s):
                    await self._changed.wait()
        if self._writer.can_write_eof():
            self._writer.write_eof()


def _is_cut(faults: Any) -> bool:
    return isinstance(faults, StreamFaults) and faults.cut
