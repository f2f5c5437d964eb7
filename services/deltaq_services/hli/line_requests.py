"""Decoding of client lines, by their `type`."""

from collections.abc import Mapping
from typing import Any

from deltaq_protocol.codec import MAX_MESSAGE_BYTES, InvalidMessageError, from_map, line_to_map, shown
from deltaq_protocol.messages import LINE_VERSIONS, Hello, Message
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.requests import BY_MODEL, BY_TYPE

# Bytes of a TCP connection until they are served as lines, and the stops among them, which wait for no turn.

MAX_LINE_BYTES = MAX_MESSAGE_BYTES
_STOPS_LOOKED_FOR = 4
"""Lines that may be stops and are looked at before their turn, each time that bytes come."""


class ReceivedLines:
    """Bytes that were received and not served yet."""

    def __init__(self) -> None:
        self._received = bytearray()
        self._searched = 0

    def __len__(self) -> int:
        """Bytes that wait."""
        return len(self._received)

    def add(self, data: bytes) -> None:
        """Take received bytes."""
        self._received += data

    def first(self) -> tuple[int, bool]:
        """Length of the first line, or of its received part, and whether it is complete."""
        end = self._received.find(b"\n", self._searched)
        self._searched = end if end >= 0 else len(self._received)
        return self._searched, end >= 0

    def take(self) -> bytes | None:
        """The first line, if it is whole."""
        end, is_whole = self.first()
        if not is_whole:
            return None
        line = bytes(self._received[:end])
        self._remove(0, end)
        return line

    def take_stop(self, begin: int) -> bool:
        """Take out a completely received stop, even if other lines wait before it.

        Args:
            begin: bytes that were looked at before.
        """
        start = self._received.rfind(b"\n", 0, begin) + 1
        for _ in range(_STOPS_LOOKED_FOR):
            found = self._received.find(b'"stop"', start)
            end = self._received.find(b"\n", found) if found >= 0 else -1
            if end < 0:
                return False
            start = self._received.rfind(b"\n", 0, found) + 1
            if end - start <= MAX_LINE_BYTES and _is_stop(bytes(self._received[start:end])):
                self._remove(start, end)
                return True
            start = end + 1
        return False

    def forget_whole(self) -> None:
        """Keep only the line that has not ended yet."""
        del self._received[: self._received.rfind(b"\n") + 1]
        self._searched = 0

    def _remove(self, start: int, end: int) -> None:
        del self._received[start : end + 1]
        self._searched = 0


def holds_stop(data: bytes) -> bool:
    """Whether a whole stop is among the first bytes of a connection."""
    lines = ReceivedLines()
    lines.add(data)
    return lines.take_stop(0)


def _is_stop(line: bytes) -> bool:
    try:
        return line_to_map(line).get("type") == "stop"
    except InvalidMessageError:
        return False


def request_type(data: dict[str, Any]) -> type[Message]:
    """The request type of a line.

    Raises:
        InvalidMessageError: nothing that a client may say.
    """
    kind = data.get("type")
    row = BY_TYPE.get(kind) if isinstance(kind, str) else None
    if row is None:
        text = f"type: must be one of {', '.join(BY_TYPE)}, got {shown(kind)}"
        raise InvalidMessageError(text, ReasonCode.MALFORMED, data)
    return row.model


def hello_of(data: dict[str, Any]) -> Hello:
    """The hello in a line; a hello of another version may have unknown fields.

    Raises:
        InvalidMessageError: the line is no hello.
    """
    protocol = data.get("protocol")
    if isinstance(protocol, int) and protocol not in LINE_VERSIONS:
        data = {"type": "hello", "protocol": protocol, "client": "of another version"}
    return from_map(Hello, data)


def of_client(request: Message, client: Hello, leases: Mapping[str, str]) -> Message:
    """A request with the name, token and lease that the connection has for its client; the line's own are replaced.

    Args:
        request: as the line has it.
        client: the hello of the connection.
        leases: token of each robot's lease that was granted to it.
    """
    robot = getattr(request, "robot", None)
    own = {"lease": leases.get(robot or ""), "client": client.client, "token": client.token}
    return request.model_copy(update={name: own[name] for name in BY_MODEL[type(request)].proven})
