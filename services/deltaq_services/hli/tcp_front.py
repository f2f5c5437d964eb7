"""JSON lines over TCP: the same session for MATLAB, Octave and anything that has a socket."""

from __future__ import annotations

import asyncio
from collections import Counter

from deltaq_protocol.codec import to_line
from deltaq_protocol.messages import Error, RobotState
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.port import Port
from deltaq_services.hli.tcp_connection import TcpConnection

MAX_CONNECTIONS = 64


class TcpFront:
    """The TCP server and its connections."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._server: asyncio.Server | None = None
        self.connections: set[TcpConnection] = set()
        self.counters: Counter[str] = Counter()

    async def listen(self, address: str, tcp_port: int) -> None:
        """Start to serve.

        Raises:
            OSError: if the address cannot be listened on.
        """
        self._server = await self._port.loop.create_server(
            lambda: TcpConnection(self._port, self), address, tcp_port
        )

    def admit(self, connection: TcpConnection) -> bool:
        """Take up a connection, unless there are too many."""
        self.counters["tcp_connections"] += 1
        if len(self.connections) >= MAX_CONNECTIONS:
            self.counters["tcp_connections_refused"] += 1
            text = f"{MAX_CONNECTIONS} connections are open, no more are allowed"
            hint = "close one that is not needed"
            connection.deliver(Error(code=ReasonCode.NOT_PERMITTED, message=text, hint=hint))
            return False
        self.connections.add(connection)
        return True

    def leave(self, connection: TcpConnection) -> None:
        """Forget a connection that broke, and tell the core what it held."""
        if connection not in self.connections:
            return
        self.connections.discard(connection)
        outputs = self._port.core.requests.on_connection_lost(connection.leases.items(), self._port.now())
        self._port.carry_out(outputs)

    def publish_state(self, state: RobotState) -> None:
        """Send a state to everybody who has said hello."""
        if self.connections:
            line = to_line(state)
            for connection in tuple(self.connections):
                connection.deliver_state(state.robot, line)

    async def close(self) -> None:
        """Stop serving and close every connection."""
        if self._server is not None:
            self._server.close()
            # cleared first: a connection that the server closes is no lost controller
            connections, self.connections = self.connections, set()
            for connection in connections:
                connection.close()
            await self._server.wait_closed()
