"""Envelopes of guarded messages: the sending process, a serial number, and the addressed process.

An envelope is `checksum (4 bytes) | sender (8) | number (8) | addressee (8)` in front of the message, big-endian. The
checksum is the CRC-32 of the zenoh key and of all bytes after the checksum. Each process draws a random number; sender
and addressee are such numbers. A message that only one service reads is addressed to that service's process. A message
that several services read, such as a state, is without addressee (0). A receiver refuses

- messages to another process: a recording of an earlier run addresses processes that have ended,
- messages of a process whose service another process has taken over, such as one that was frozen and woke up,
- messages that it has received before, or that a newer message under the same key has overtaken.

An envelope is no cryptography. Unix permissions or mutual TLS decide who can connect to the guarded realm.
"""

import secrets
import struct
from collections.abc import Sequence
from zlib import crc32

from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.sayings import sayings

_CHECKSUM = struct.Struct(">I")
_PROCESSES = struct.Struct(">QQQ")
_ENVELOPE_BYTES = _CHECKSUM.size + _PROCESSES.size
_NOBODY = 0


class StaleMessageError(ProtocolError):
    """A message to another process, from a process that was replaced, or older than one that has come."""


class MisaddressedError(StaleMessageError):
    """A message is addressed to another process. Its sender does not know this process yet."""


class Envelopes:
    """Puts one process's messages into envelopes and checks received ones; not thread-safe.

    Args:
        service: the service that this process is.
        cell: name of the cell.
        robots: names of its robots.
    """

    def __init__(self, service: str, cell: str, robots: Sequence[str]) -> None:
        self._service = service
        self._process = secrets.randbits(63) + 1
        self._number = 0
        rows = sayings(cell, robots)
        self._speakers = {row.key: row.speaker for row in rows if service in row.listeners}
        self._addressees = {row.key: row.listeners[0] for row in rows if len(row.topic.readers) == 1}
        self._present: dict[str, int] = {}
        self._newest: dict[str, int] = {}
        self._ended: set[int] = set()

    def close(self, key: str, message: bytes) -> bytes:
        """The bytes to publish under a zenoh key."""
        self._number += 1
        addressee = self._present.get(self._addressees.get(key, ""), _NOBODY)
        body = _PROCESSES.pack(self._process, self._number, addressee) + message
        return _CHECKSUM.pack(_checksum(key, body)) + body

    def open(self, key: str, enclosed: bytes) -> bytes:
        """Check an envelope received under a zenoh key, and return its message.

        Raises:
            InvalidMessageError: it is damaged.
            MisaddressedError: it was sent to another process.
            StaleMessageError: its sender was replaced, or a newer message has come.
        """
        speaker = self._speakers.get(key)
        if speaker is None:
            raise StaleMessageError(f"{key}: nothing there is for {self._service}")
        if len(enclosed) < _ENVELOPE_BYTES or _CHECKSUM.unpack_from(enclosed)[0] != _checksum(
            key, enclosed[_CHECKSUM.size :]
        ):
            text = f"{key}: {len(enclosed)} damaged bytes"
            raise InvalidMessageError(text, ReasonCode.MALFORMED)
        sender, number, addressee = _PROCESSES.unpack_from(enclosed, _CHECKSUM.size)
        if sender in self._ended:
            raise StaleMessageError(f"{key}: from a process of {speaker} that was replaced")
        if key in self._addressees and addressee != self._process:
            raise MisaddressedError(f"{key}: sent to another process")
        before = self._present.get(speaker)
        if sender != before:
            if before is not None:
                self._ended.add(before)
            self._present[speaker] = sender
            for said in (key for key, other in self._speakers.items() if other == speaker):
                self._newest.pop(said, None)
        newest = self._newest.get(key, 0)
        if number <= newest:
            raise StaleMessageError(f"{key}: number {number} of its sender, {newest} has come already")
        self._newest[key] = number
        return message_in(enclosed)


def message_in(enclosed: bytes) -> bytes:
    """The message in an envelope, for a process that only watches: addressee and age are not checked."""
    return enclosed[_ENVELOPE_BYTES:]


def sender_of(enclosed: bytes) -> int:
    """The process that sent a message, for a process that only watches."""
    sender: int = _PROCESSES.unpack_from(enclosed, _CHECKSUM.size)[0]
    return sender


def _checksum(key: str, body: bytes) -> int:
    return crc32(body, crc32(key.encode()))
