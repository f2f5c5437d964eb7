"""JSON lines over TCP: sessions for MATLAB, Octave and any program with a socket."""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections import Counter
from typing import TYPE_CHECKING

from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.codec import to_line
from deltaq_protocol.messages import Description, Error, Hello, RobotState
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.commands import Deed
from deltaq_services.hli.newcomers import HANDSHAKE_S, Handshake, Newcomers
from deltaq_services.hli.places import MAX_CONNECTIONS, MAX_OF_A_PEER, LineTurns, Places
from deltaq_services.hli.tcp_connection import TcpConnection, address_of
from deltaq_services.outputs import ClientOrigin
from deltaq_services.rate_limit import Tries

if TYPE_CHECKING:
    from deltaq_services.hli.shell import Hli

_log = logging.getLogger(__name__)

_LINES_A_TURN = 16
"""Lines served in a turn, before the loop serves states and other clients."""
_HANDSHAKES_A_SECOND = 64.0
"""Connections with which an encryption is agreed on; each takes a millisecond or two."""
_WAIT_S = 0.005
"""Where lines wait for their rates, they are looked at again after this."""


class TcpFront:
    """The TCP server and its connections.

    Attributes:
        counters: of the server and its connections.
    """

    def __init__(self, port: Hli) -> None:
        self._port = port
        self._newcomers: Newcomers | None = None
        self._encryption: ssl.SSLContext | None = None
        self._places: Places[TcpConnection] = Places()
        self._turns: LineTurns[TcpConnection] = LineTurns()
        self._tries = Tries()
        self._is_scheduled = False
        self._described: Description | None = None
        self._description_line = b""
        self.counters: Counter[str] = Counter()

    @property
    def connections(self) -> tuple[TcpConnection, ...]:
        """Clients that have a place."""
        return tuple(self._places.clients)

    @property
    def description_line(self) -> bytes:
        """The longest answer, made once for each tool that a robot has."""
        if self._described is not self._port.core.description:
            self._described = self._port.core.description
            self._description_line = to_line(self._described)
        return self._description_line

    async def listen(self, address: str, tcp_port: int, encryption: ssl.SSLContext | None) -> None:
        """Start to serve; `encryption`: None where lines are in the clear.

        Raises:
            OSError: if the address cannot be listened on.
        """
        loop, counters = self._port.loop, self.counters
        self._encryption = encryption
        if encryption is None:
            newcomers = Newcomers(loop, self._begin, counters)
        else:  # a connection that has said nothing yet may bring a stop in the clear
            newcomers = Newcomers(loop, self._begin, counters, _HANDSHAKES_A_SECOND, silent_s=HANDSHAKE_S)
        await newcomers.listen(address, tcp_port)
        self._newcomers = newcomers

    def admit(self, connection: TcpConnection, address: str, is_encrypted: bool) -> bool:
        """Accept a connection as a client's; False: only for a stop, in the clear or since no place is left."""
        self.counters["tcp_connections"] += 1
        may_be_client = self._encryption is None or is_encrypted
        if may_be_client and self._places.take(connection, address):
            return True
        gives_way = self._places.keep_for_stop(connection)
        if gives_way is not None:
            gives_way.close()
        if may_be_client:
            self._refuse_one_more(connection, address)
        return False

    def _refuse_one_more(self, connection: TcpConnection, address: str) -> None:
        self.counters["tcp_connections_refused"] += 1
        text = (
            f"{MAX_CONNECTIONS} connections are open, or {MAX_OF_A_PEER} from {address}: no more are allowed"
        )
        hint = "close one that is not needed; a stop is still obeyed on this connection, if it comes now"
        connection.deliver(Error(code=ReasonCode.TOO_MANY, message=text, hint=hint))
        refused = AuditOutcome.REFUSED
        self._port.core.tell(
            Deed(AuditKind.CONNECTED, refused, connection.origin, code=ReasonCode.TOO_MANY, text=text)
        )

    def proven(self, hello: Hello, address: str) -> Hello | None:
        """The hello with its proven token; None for a wrong token, or after too many wrong ones from its address."""
        if hello.token is None and hello.proof is None:
            return hello
        now = self._port.now()
        if not self._tries.may_try(address, now):
            self.counters["tokens_not_compared"] += 1
            return None
        if hello.proof is not None and self._port.roles.tokens:
            token = self._port.authentication.token_of_line(hello.challenge or "", hello.proof, now)
        else:
            token = None if self._port.roles.is_wrong(hello.token or "") else hello.token or ""
        if token is not None:
            return hello.model_copy(update={"token": token})
        self._tries.failed(address, now)
        self.counters["tokens_wrong"] += 1
        _log.warning("a wrong token from %s, who claims to be %r", address, hello.client)
        return None

    def leave(self, connection: TcpConnection) -> None:
        """Remove a broken connection, and end its leases in the core."""
        self._turns.leave(connection)
        if self._places.leave(connection):
            if connection.is_welcome:
                self._port.core.tell(Deed(AuditKind.DISCONNECTED, AuditOutcome.DONE, connection.origin))
            on_lost, leases = self._port.core.requests.on_connection_lost, connection.leases
            self._port.serve(lambda: on_lost(leases.items(), self._port.now()), leases)

    def wants_turn(self, connection: TcpConnection) -> None:
        """Serve a waiting line of a connection, at once or in its turn."""
        self._turns.wait(connection, is_holder=bool(connection.leases))
        if not self._is_scheduled:
            self._serve()

    def publish_state(self, state: RobotState) -> None:
        """Send a state to every client that has said hello."""
        if self._places.clients:
            line = to_line(state)
            for connection in self.connections:
                connection.deliver_state(state.robot, line)

    async def close(self) -> None:
        """Stop serving and close every connection."""
        if self._newcomers is not None:
            await self._newcomers.close()
        # forgotten first: a connection that the server closes is no lost controller
        connections, self._places = self.connections, Places()
        for connection in connections:
            connection.close()

    def _new_connection(self) -> TcpConnection:
        return TcpConnection(self._port, self)

    def _begin(self, brings_stop: bool) -> asyncio.Protocol:
        """The protocol of a new connection; one that brings a stop waits for no encryption."""
        if self._encryption is None or brings_stop:
            return self._new_connection()
        return Handshake(self._port.loop, self._encryption, self._new_connection, self._refuse_unencrypted)

    def _refuse_unencrypted(self, transport: asyncio.BaseTransport, why: str) -> None:
        self.counters["tcp_unencrypted"] += 1
        origin = ClientOrigin(address=address_of(transport))
        text = f"no encryption was agreed on: {why}"
        self._port.core.tell(
            Deed(AuditKind.CONNECTED, AuditOutcome.REFUSED, origin, code=ReasonCode.MALFORMED, text=text)
        )

    def _serve(self) -> None:
        self._is_scheduled = True
        for _ in range(_LINES_A_TURN):
            connection = self._turns.next(self._port.now())
            if connection is None:
                break
            try:
                has_more = connection.serve_line()
            except Exception:  # no line may end the process, or keep others from their turns
                self.counters["failed"] += 1
                _log.exception("a line could not be served")
                has_more = False
                connection.close()
            if has_more:
                self._turns.wait(connection, is_holder=bool(connection.leases))
        else:
            self._port.loop.call_soon(self._serve)
            return
        self._is_scheduled = False
        if self._turns:
            self._is_scheduled = True
            self.counters["tcp_lines_slowed"] += 1
            self._port.loop.call_later(_WAIT_S, self._serve)
