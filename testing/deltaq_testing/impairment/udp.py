"""A relay for UDP datagrams that impairs them, such as RSI between a KRC and its Robot Server."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Mapping
from typing import Self

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import ServiceUnreachableError


class Pump:
    """One direction of a link that carries whole messages.

    Args:
        loop: that carries.
        deliver: called with each message that arrives.
        seed: of the link's random numbers.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, deliver: Callable[[bytes], None], seed: int = 0
    ) -> None:
        self._loop, self._deliver = loop, deliver
        self._link = FaultyLink(seed)
        self._timer: asyncio.TimerHandle | None = None

    @property
    def counts(self) -> Mapping[str, int]:
        """Faults so far."""
        return self._link.counts

    def impair(self, faults: LinkFaults) -> None:
        """Do this from now on."""
        self._link.faults = faults

    def put(self, message: bytes) -> None:
        """A message enters."""
        self._link.put(self._loop.time(), message)
        self._carry()

    def close(self) -> None:
        """Stop delivering."""
        if self._timer is not None:
            self._timer.cancel()

    def _carry(self) -> None:
        self.close()
        for message in self._link.take(self._loop.time()):
            self._deliver(message)
        if self._link.next_s is not None:
            self._timer = self._loop.call_at(self._link.next_s, self._carry)


MAX_SENDERS = 16
"""Largest number of senders; a further one replaces the first."""
_DATAGRAM_BYTES = 65_535
_READ_A_TURN = 64


class UdpRelay:
    """Relays datagrams to another address, and answers back to their senders; an async context manager.

    Args:
        listen: address at which datagrams arrive.
        to: address to which they are relayed.
        seed: of the random numbers.

    Raises:
        ServiceUnreachableError: on entering, if `listen` cannot be listened on, or `to` has no address.
    """

    def __init__(self, listen: Endpoint, to: Endpoint, seed: int = 0) -> None:
        self._listen, self._to, self._seed = listen, to, seed
        self._faults = LinkFaults()
        self._exchanges: dict[tuple[str, int], _Exchange] = {}

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._address = (socket.gethostbyname(self._to.host), self._to.port)
            self._socket.bind((self._listen.host, self._listen.port))
        except OSError as error:
            self._socket.close()
            raise ServiceUnreachableError(
                f"cannot carry datagrams from {self._listen} to {self._to}: {error.strerror}; is the first a free "
                "address of this machine, and does the second exist?"
            ) from error
        self._loop.add_reader(self._socket, self._read)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._loop.remove_reader(self._socket)
        self._socket.close()
        for exchange in self._exchanges.values():
            exchange.close()

    def impair(self, faults: LinkFaults) -> None:
        """Set the faults from now on, in both directions."""
        self._faults = faults
        for exchange in self._exchanges.values():
            exchange.impair(faults)

    def _read(self) -> None:
        for _ in range(_READ_A_TURN):
            try:
                datagram, sender = self._socket.recvfrom(_DATAGRAM_BYTES)
            except OSError:
                return  # none is left, or an answer did not arrive where it was sent
            exchange = self._exchanges.get(sender)
            if exchange is None:
                exchange = self._begin(sender)
            exchange.take(datagram)

    def _begin(self, sender: tuple[str, int]) -> _Exchange:
        if len(self._exchanges) >= MAX_SENDERS:
            self._exchanges.pop(next(iter(self._exchanges))).close()

        def answer(datagram: bytes) -> None:
            with contextlib.suppress(OSError):  # as on any network
                self._socket.sendto(datagram, sender)

        exchange = _Exchange(self._loop, self._address, answer, self._seed)
        exchange.impair(self._faults)
        self._exchanges[sender] = exchange
        self._seed += 2
        return exchange


class _Exchange:
    """One sender and its answers."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        to: tuple[str, int],
        answer: Callable[[bytes], None],
        seed: int,
    ) -> None:
        self._loop = loop
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(to)
        self._onward, self._back = Pump(loop, self._send, seed), Pump(loop, answer, seed + 1)
        loop.add_reader(self._socket, self._read)

    def impair(self, faults: LinkFaults) -> None:
        self._onward.impair(faults)
        self._back.impair(faults)

    def take(self, datagram: bytes) -> None:
        self._onward.put(datagram)

    def close(self) -> None:
        self._loop.remove_reader(self._socket)
        self._onward.close()
        self._back.close()
        self._socket.close()

    def _send(self, datagram: bytes) -> None:
        with contextlib.suppress(OSError):  # no listener there, or not yet
            self._socket.send(datagram)

    def _read(self) -> None:
        for _ in range(_READ_A_TURN):
            try:
                self._back.put(self._socket.recv(_DATAGRAM_BYTES))
            except OSError:
                return
