"""The encryption of a connection, agreed on before anybody else hears of it; who fails in that is told of."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable

from deltaq_protocol.certified.names import person_named
from deltaq_services.hli.waiting_places import WaitingPlaces

HANDSHAKE_S = 5.0
"""Connections that do not agree on their encryption until then end."""


class Handshake(asyncio.Protocol):
    """Begins as a connection's protocol, and passes the encrypted connection on.

    Args:
        loop: the event loop that serves it.
        encryption: context with the certificate.
        begin: makes the protocol of an encrypted connection.
        failed: takes the transport, and the reason why no encryption was agreed on.
        places: places of connections that have not agreed on encryption yet.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        encryption: ssl.SSLContext,
        begin: Callable[[], asyncio.Protocol],
        failed: Callable[[asyncio.BaseTransport, str], None],
        places: WaitingPlaces[Handshake],
    ) -> None:
        self._loop, self._encryption = loop, encryption
        self._begin, self._failed = begin, failed
        self._places = places
        self._connection: asyncio.Protocol | None = None
        self._gave_way = ""
        self._early = bytearray()
        self._is_lost = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Somebody has connected."""
        assert isinstance(transport, asyncio.Transport)  # of a TCP server, always
        transport.pause_reading()  # what comes is for the encryption
        self._transport = transport
        peer = transport.get_extra_info("peername")
        older = self._places.take(self, peer[0] if peer else "")
        if older is not None:
            older.give_way()
        self._task = self._loop.create_task(self._agree(transport))

    def data_received(self, data: bytes) -> None:
        """What was encrypted, and came with the end of the agreement."""
        if self._connection is None:
            self._early += data
        else:
            self._connection.data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended before this handed it on, or as it did."""
        self._is_lost = True
        if self._connection is not None:
            self._connection.connection_lost(exc)

    def give_way(self) -> None:
        """End, for one that came later."""
        self._gave_way = "too many were agreeing on theirs, and this was the oldest"
        self._transport.abort()

    async def _agree(self, transport: asyncio.Transport) -> None:
        try:
            encrypted = await self._loop.start_tls(
                transport, self, self._encryption, server_side=True, ssl_handshake_timeout=HANDSHAKE_S
            )
        except OSError as error:
            why = error.reason if isinstance(error, ssl.SSLError) else type(error).__name__
            self._failed(transport, self._gave_way or why)
            transport.abort()
            return
        finally:
            self._places.leave(self)
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
