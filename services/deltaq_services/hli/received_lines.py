"""Bytes of a TCP connection until they are served as lines, and the stops among them, which wait for no turn."""

from __future__ import annotations

from deltaq_protocol.codec import MAX_MESSAGE_BYTES, InvalidMessageError, line_to_map

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
        """Bytes have come."""
        self._received += data

    def first(self) -> tuple[int, bool]:
        """Length of the first line, or of what there is of it, and whether it is whole."""
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
        """Take out a stop that has come whole, even if other lines wait before it.

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
