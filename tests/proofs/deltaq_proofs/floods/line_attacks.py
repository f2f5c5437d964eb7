"""Floods at the port of the JSON lines: each attack is one step that an attacker repeats as fast as it can."""

from __future__ import annotations

import contextlib
import json
import socket
import ssl
from collections import deque
from collections.abc import Callable

from deltaq_cell.description import CellDescription
from deltaq_protocol.messages import PROTOCOL_VERSION

Step = Callable[[], None]

_BLOCK = 64
"""Lines in one write."""
_KEPT = 400
"""Connections that an attacker keeps open at a time."""
_HELLO = json.dumps({"type": "hello", "protocol": PROTOCOL_VERSION, "client": "flood"}).encode() + b"\n"
_TIMEOUT_S = 5.0


def lines(cell: CellDescription) -> Step:
    """Valid lines of one connection, whose answers are read."""
    return _written(cell, b'{"type":"describe"}\n' * _BLOCK)


def increments_over_lines(cell: CellDescription) -> Step:
    """Increments without a lease."""
    robot = next(iter(cell.robots))
    line = {"type": "increment", "robot": robot, "seq": 1, "cycle": 1, "dq": [0.0] * 6}
    return _written(cell, (json.dumps(line).encode() + b"\n") * _BLOCK)


def oversized_lines(cell: CellDescription) -> Step:
    """Lines of a megabyte; the connection ends, and another takes its place."""
    return _written(cell, b"x" * 2**20 + b"\n")


def unterminated_lines(cell: CellDescription) -> Step:
    """Bytes without an end of a line."""
    return _written(cell, b'{"type":"describe",' * 1000)


def connections(cell: CellDescription) -> Step:
    """New connections that say nothing; the oldest is closed for each."""
    return _opened(lambda: _connected(cell))


def handshakes(cell: CellDescription) -> Step:
    """New connections to encrypted lines that agree on nothing, half of them after they have begun to."""
    begun: list[bool] = []
    hello = _client_hello()

    def opened() -> socket.socket:
        connection = _connected(cell)
        if len(begun) % 2:
            connection.sendall(hello)
        begun.append(True)
        return connection

    return _opened(opened)


def stops_over_lines(cell: CellDescription) -> Step:
    """Stops of one connection."""
    return _written(cell, b'{"type":"stop"}\n')


def slow_readers(cell: CellDescription) -> Step:
    """Connections that ask for the longest answer and read none."""

    def opened() -> socket.socket:
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # before it connects: full at once
        connection.settimeout(_TIMEOUT_S)
        connection.connect((cell.tcp_address, cell.tcp_port))
        connection.sendall(_HELLO + b'{"type":"describe"}\n' * _BLOCK)
        return connection

    return _opened(opened)


def _connected(cell: CellDescription) -> socket.socket:
    return socket.create_connection((cell.tcp_address, cell.tcp_port), _TIMEOUT_S)


def _opened(connect: Callable[[], socket.socket]) -> Step:
    kept: deque[socket.socket] = deque()

    def step() -> None:
        if len(kept) == _KEPT:
            kept.popleft().close()
        kept.append(connect())

    return step


def _written(cell: CellDescription, data: bytes) -> Step:
    """Write the same again and again; a connection that ends is made anew. Answers are thrown away as they come."""
    connection: list[socket.socket] = []

    def step() -> None:
        if not connection:
            connection.append(_connected(cell))
            connection[0].sendall(_HELLO)
            connection[0].setblocking(False)
        try:
            _write(connection[0], data)
        except OSError:
            connection.pop().close()

    return step


def _write(connection: socket.socket, data: bytes) -> None:
    left = memoryview(data)
    while left:
        try:
            while connection.recv(2**16):
                pass
            raise ConnectionResetError
        except BlockingIOError:
            pass
        try:
            left = left[connection.send(left) :]
        except BlockingIOError:
            connection.settimeout(0.001)
            try:
                connection.recv(2**16)
            except TimeoutError:
                pass
            finally:
                connection.setblocking(False)


def _client_hello() -> bytes:
    """The first message of a handshake, which costs the other side a signature to answer."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(incoming, outgoing).do_handshake()
    return outgoing.read()
