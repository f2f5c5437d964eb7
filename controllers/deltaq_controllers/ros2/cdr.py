"""CDR as ROS 2 sends it: version 1 of XCDR, little-endian, behind four bytes of encapsulation.

A number is aligned to its own size, counted from behind the encapsulation. A string has its length before it and a zero
behind it, and both count the zero. A sequence has its count before it; an empty one of 8-byte numbers is not aligned.
Source: OMG Data-Distribution Service Interoperability Wire Protocol 2.2, 10.2, and DDS X-Types 1.3, 7.4.

What is read may come from anybody: a length is compared with its bound, and with the bytes that are left, before
anything of that length is made.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from deltaq_controllers.ros2.refusal import RefusedMessageError

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian; no options."""

_PADDING = 3
"""Bytes that may follow the last field: some senders fill up to a multiple of four."""


class CdrWriter:
    """Appends fields in their order; `message` returns the bytes."""

    def __init__(self) -> None:
        self._body = bytearray()

    @property
    def message(self) -> bytes:
        """All that was written, with its encapsulation."""
        return ENCAPSULATION + bytes(self._body)

    def int32(self, value: int) -> None:
        """A signed number of four bytes."""
        self._align(4)
        self._body += struct.pack("<i", value)

    def uint32(self, value: int) -> None:
        """An unsigned number of four bytes."""
        self._align(4)
        self._body += struct.pack("<I", value)

    def string(self, value: str) -> None:
        """A string in UTF-8."""
        text = value.encode() + b"\x00"
        self.uint32(len(text))
        self._body += text

    def strings(self, values: Iterable[str]) -> None:
        """A sequence of strings."""
        values = tuple(values)
        self.uint32(len(values))
        for value in values:
            self.string(value)

    def float64s(self, values: Iterable[float]) -> None:
        """A sequence of doubles."""
        values = tuple(values)
        self.uint32(len(values))
        if values:
            self._align(8)
            self._body += struct.pack(f"<{len(values)}d", *values)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)


class CdrReader:
    """Reads fields in their order; each names itself for the error.

    Args:
        message: with its encapsulation.

    Raises:
        RefusedMessageError: from here and from every method, if the bytes are not such a field.
    """

    def __init__(self, message: bytes) -> None:
        if message[:2] != ENCAPSULATION[:2]:
            kind = message[:4].hex(" ") or "missing"
            raise RefusedMessageError(
                "malformed", "encapsulation", kind, "00 01 00 00 (plain CDR, little-endian)"
            )
        if len(message) < len(ENCAPSULATION):
            raise RefusedMessageError("malformed", "message", f"{len(message)} bytes", "4 bytes or more")
        self._body = message[len(ENCAPSULATION) :]
        self._at = 0

    def int32(self, field: str) -> int:
        """A signed number of four bytes."""
        (value,) = struct.unpack("<i", self._bytes(4, 4, field))
        return int(value)

    def uint32(self, field: str) -> int:
        """An unsigned number of four bytes."""
        (value,) = struct.unpack("<I", self._bytes(4, 4, field))
        return int(value)

    def count(self, field: str, most: int, element_bytes: int) -> int:
        """How many elements a sequence has.

        Args:
            field: its name.
            most: elements that are allowed.
            element_bytes: least size of one [bytes].
        """
        count = self.uint32(field)
        if count > most:
            raise RefusedMessageError("too_long", field, f"of length {count}", f"{most} or less")
        if count * element_bytes > len(self._body) - self._at:
            left = f"no more than the {len(self._body) - self._at} bytes that follow hold"
            raise RefusedMessageError("malformed", field, f"of length {count}", left)
        return count

    def string(self, field: str, most_bytes: int) -> str:
        """A string of up to so many bytes in UTF-8, its zero included."""
        size = self.count(field, most_bytes, 1)
        text = self._bytes(size, 1, field)
        if not text or text[-1] != 0 or 0 in text[:-1]:
            raise RefusedMessageError("malformed", field, "not ended by its only zero", "a CDR string")
        try:
            return text[:-1].decode()
        except UnicodeDecodeError:
            raise RefusedMessageError("malformed", field, "not in UTF-8", "a text in UTF-8") from None

    def strings(self, field: str, most: int, most_bytes: int) -> tuple[str, ...]:
        """A sequence of up to `most` strings."""
        count = self.count(field, most, 5)
        return tuple(self.string(f"{field}[{k}]", most_bytes) for k in range(count))

    def float64s(self, field: str, most: int) -> tuple[float, ...]:
        """A sequence of up to `most` doubles of any value."""
        count = self.count(field, most, 8)
        if not count:
            return ()
        return struct.unpack(f"<{count}d", self._bytes(8 * count, 8, field))

    def end(self) -> None:
        """Nothing may be left but padding."""
        left = len(self._body) - self._at
        if left > _PADDING:
            raise RefusedMessageError(
                "malformed", "message", f"{left} bytes too long", "the fields of its type"
            )

    def _bytes(self, size: int, alignment: int, field: str) -> bytes:
        begin = self._at + -self._at % alignment
        end = begin + size
        if end > len(self._body):
            given = f"cut off after {len(self._body) + len(ENCAPSULATION)} bytes"
            raise RefusedMessageError("malformed", field, given, "a whole field")
        self._at = end
        return self._body[begin:end]
