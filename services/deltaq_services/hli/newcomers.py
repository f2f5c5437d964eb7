"""TCP connections until they are accepted as clients.

Making a client of a connection takes longer than opening one, so a flood would fill the system's queue, and others
would have to retry. So all connections are opened as they come, which costs little, and then accepted in this order:
those that have sent a stop, those that have sent anything, the others. Addresses take turns, the newest connection
first, and connections without a stop are accepted at a bounded rate.

With encrypted lines the content of a connection is unknown before it is accepted, except for a stop in the clear:
    any client may stop, so it is obeyed at once, without a TLS handshake.
"""

import asyncio
import logging
import select
import socket
import ssl
from collections import Counter
from collections.abc import Callable
from itertools import islice

from deltaq_protocol.certified.names import person_named
from deltaq_services.hli.line_requests import holds_stop
from deltaq_services.hli.places import WaitingPlaces
from deltaq_services.rate_limit import RateLimit

# The TLS handshake of a connection, before it becomes a client; failed handshakes are reported.

HANDSHAKE_S = 5.0
"""Connections that do not agree on their encryption until then end."""


class Handshake(asyncio.Protocol):
    """Begins as a connection's protocol, and passes the encrypted connection on.

    There are no more of them than `Newcomers` takes up within `HANDSHAKE_S`.

    Args:
        loop: the event loop that serves it.
        encryption: context with the certificate.
        begin: makes the protocol of an encrypted connection.
        failed: takes the transport, and the reason why no encryption was agreed on.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        encryption: ssl.SSLContext,
        begin: Callable[[], asyncio.Protocol],
        failed: Callable[[asyncio.BaseTransport, str], None],
    ) -> None:
        self._loop, self._encryption = loop, encryption
        self._begin, self._failed = begin, failed
        self._connection: asyncio.Protocol | None = None
        self._early = bytearray()
        self._is_lost = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A client has connected."""
        assert isinstance(transport, asyncio.Transport)  # of a TCP server, always
        transport.pause_reading()  # the bytes belong to the handshake
        self._task = self._loop.create_task(self._agree(transport))

    def data_received(self, data: bytes) -> None:
        """Encrypted bytes received together with the end of the handshake."""
        if self._connection is None:
            self._early += data
        else:
            self._connection.data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended before this handed it on, or as it did."""
        self._is_lost = True
        if self._connection is not None:
            self._connection.connection_lost(exc)

    async def _agree(self, transport: asyncio.Transport) -> None:
        try:
            encrypted = await self._loop.start_tls(
                transport, self, self._encryption, server_side=True, ssl_handshake_timeout=HANDSHAKE_S
            )
        except OSError as error:
            why = error.reason if isinstance(error, ssl.SSLError) else type(error).__name__
            self._failed(transport, why)
            transport.abort()
            return
        if self._is_lost or encrypted is None:
            return
        connection = self._connection = self._begin()
        encrypted.set_protocol(connection)
        connection.connection_made(encrypted)
        if self._early:
            connection.data_received(bytes(self._early))


def identity_of(transport: asyncio.BaseTransport) -> str:
    """The name that an encrypted connection's client has proven by its certificate; empty without one."""
    encrypted = transport.get_extra_info("ssl_object")
    certificate = None if encrypted is None else encrypted.getpeercert()
    names = dict(pair for part in (certificate or {}).get("subject", ()) for pair in part)
    return person_named(names.get("commonName", ""))


_log = logging.getLogger(__name__)

_LET_IN_A_TURN = 64
"""Connections that are let in before the loop turns to others."""
_TAKEN_UP_A_TURN = 8
_QUEUE = 1024
"""Connections that the system keeps until they are let in."""
_LOOK_S = 0.005
"""Between two looks at those that have to wait."""
_REST_S = 1.0
"""After an error of the system, as for want of descriptors."""
_PEEKED_BYTES = 4096


class Newcomers:
    """Listens, and accepts connections as clients.

    Args:
        loop: the event loop.
        begin: makes the protocol of an accepted connection; its argument says whether it has sent a stop.
        counters: are added to.
        per_second: greatest number of connections without a stop accepted in a second.
        silent_s: silent connections are accepted after this delay [s].
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        begin: Callable[[bool], asyncio.Protocol],
        counters: Counter[str],
        per_second: float = 256.0,
        silent_s: float = 0.0,
    ) -> None:
        self._loop, self._begin, self._counters = loop, begin, counters
        self._rate = RateLimit(per_second)
        self._silent_s = silent_s
        self._listeners: list[socket.socket] = []
        self._waiting: WaitingPlaces[socket.socket] = WaitingPlaces()
        self._silent: dict[int, socket.socket] = {}
        self._let_in_s: dict[socket.socket, float] = {}
        self._spoken: dict[socket.socket, bool] = {}
        self._heard = select.poll()
        self._taken_up: set[asyncio.Task[None]] = set()
        self._look: asyncio.Handle | None = None

    async def listen(self, address: str, port: int) -> None:
        """Let connections in from now on.

        Raises:
            OSError: if the address cannot be listened on.
        """
        bound = await self._loop.create_server(asyncio.Protocol, address, port, start_serving=False)
        self._listeners = [socket.socket(fileno=each.dup().detach()) for each in bound.sockets]
        bound.close()
        for listener in self._listeners:
            listener.setblocking(False)
            listener.listen(_QUEUE)
            self._loop.add_reader(listener, self._let_in, listener)

    async def close(self) -> None:
        """Stop listening, and close the waiting connections."""
        for listener in self._listeners:
            self._loop.remove_reader(listener)
            listener.close()
        self._listeners = []
        if self._look is not None:
            self._look.cancel()
        for one in list(self._waiting):
            self._send_away(one)
        await asyncio.gather(*self._taken_up)

    def _let_in(self, listener: socket.socket) -> None:
        for _ in range(_LET_IN_A_TURN):
            try:
                one, address = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                break
            except OSError as error:
                _log.error("no connection can be accepted: %s", error)
                self._loop.remove_reader(listener)
                self._loop.call_later(_REST_S, self._go_on, listener)
                break
            one.setblocking(False)
            gives_way = self._waiting.take(one, address[0])
            if gives_way is not None:
                self._counters["tcp_connections_given_way"] += 1
                self._send_away(gives_way)
            self._silent[one.fileno()] = one
            self._let_in_s[one] = self._loop.time()
            self._heard.register(one, select.POLLIN)
        if self._look is None and len(self._waiting):
            self._look = self._loop.call_soon(self._take_up)

    def _go_on(self, listener: socket.socket) -> None:
        if listener in self._listeners:
            self._loop.add_reader(listener, self._let_in, listener)

    def _take_up(self) -> None:
        """Accept some of the waiting connections."""
        self._look = None
        self._listen_to_the_silent()
        chosen = list(islice((one for one in self._waiting if self._spoken.get(one)), _TAKEN_UP_A_TURN))
        spoken = (one for one in self._waiting if self._spoken.get(one) is False)
        silent = (one for one in self._waiting if one not in self._spoken and self._has_waited(one))
        for others in (spoken, silent):
            for one in others:
                if len(chosen) == _TAKEN_UP_A_TURN or not self._rate.take(self._loop.time()):
                    break
                chosen.append(one)
        for one in chosen:
            brings_stop = bool(self._spoken.get(one))
            self._forget(one)
            task = self._loop.create_task(self._hand_over(one, brings_stop))
            self._taken_up.add(task)
            task.add_done_callback(self._taken_up.discard)
        if len(self._waiting):
            again = self._take_up
            self._look = self._loop.call_soon(again) if chosen else self._loop.call_later(_LOOK_S, again)

    def _has_waited(self, one: socket.socket) -> bool:
        return self._loop.time() - self._let_in_s[one] >= self._silent_s

    def _listen_to_the_silent(self) -> None:
        """Look at the first bytes of each connection, without consuming them."""
        for descriptor, _ in self._heard.poll(0):
            one = self._silent[descriptor]
            try:
                brought = one.recv(_PEEKED_BYTES, socket.MSG_PEEK)
            except OSError:
                brought = b""
            if brought:
                self._no_longer_silent(one)
                self._spoken[one] = holds_stop(brought)
            else:
                self._send_away(one)

    async def _hand_over(self, one: socket.socket, brings_stop: bool) -> None:
        try:
            await self._loop.connect_accepted_socket(lambda: self._begin(brings_stop), one)
        except OSError:  # it has ended
            one.close()

    def _send_away(self, one: socket.socket) -> None:
        self._forget(one)
        one.close()

    def _forget(self, one: socket.socket) -> None:
        self._waiting.leave(one)
        del self._let_in_s[one]
        if self._spoken.pop(one, None) is None:
            self._no_longer_silent(one)

    def _no_longer_silent(self, one: socket.socket) -> None:
        del self._silent[one.fileno()]
        self._heard.unregister(one)
