"""Seals on the messages of the guarded realm: who made a message, as which of its messages, and for which processes.

A sealed message is `MAC (32 bytes) | sender (8) | number (8) | count (1) | receivers (8 each) | message`. The MAC is
BLAKE2b keyed with the realm's key (RFC 7693, 2.9) over the zenoh key and all that follows it, so that a message is
invalid under another zenoh key; fields of the message itself bind it to gate epoch, lease epoch, sequence and cycle.

Sender and receivers are processes, each by a random number of its own. A process acts only upon what names it as a
receiver: a message that was recorded before it began cannot. It learns of the others by what they send, and tells them
of itself by a greeting whenever one does not know it yet. Numbers of a sender only grow, and each is valid once; a
sender that another has taken the place of is not heard again. No clock is involved.
"""

from __future__ import annotations

import contextlib
import secrets
from collections import deque
from hashlib import blake2b
from hmac import compare_digest

from deltaq_protocol.errors import ProtocolError

KEY_BYTES = 32
_MAC_BYTES = 32
_LENGTH_BYTES = 8
_PROCESS_BYTES = 8
_NUMBER_BYTES = 8
_NUMBER = _MAC_BYTES + _PROCESS_BYTES
_COUNT = _NUMBER + _NUMBER_BYTES
_RECEIVERS = _COUNT + 1
_MOST_RECEIVERS = 255
MAX_SEALED_BYTES = 16 * 1024
"""Longest sealed message, many times what services send: nobody shall keep one busy with the MACs of long ones."""
_NEWCOMERS = 4
"""Processes under one zenoh key that are told of this one, though they have not shown that they know it."""


class ForgedMessageError(ProtocolError):
    """A message without the right seal, a duplicate, or one of a process that another has taken the place of."""


class UnboundMessageError(ProtocolError):
    """A message that holders of the key made, but not for this process: its sender has not heard of it, or is gone."""


class _Link:
    """What was heard under one zenoh key: its sender, and who claims to be its successor."""

    def __init__(self) -> None:
        self.sender = b""
        self.number = 0
        self.ended: set[bytes] = set()
        self.newcomers: deque[bytes] = deque(maxlen=_NEWCOMERS)


class Seal:
    """Seals what a process publishes and opens what it receives; one for each process, used by one thread.

    Args:
        key: the realm's, `KEY_BYTES` long.
    """

    def __init__(self, key: bytes) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"the key has {len(key)} bytes; it must have {KEY_BYTES}")
        self._key = key
        self._process = secrets.token_bytes(_PROCESS_BYTES)
        self._number = 0
        self._links: dict[str, _Link] = {}
        self._receivers = b"\0"

    def close(self, zenoh_key: str, message: bytes) -> bytes:
        """The bytes to publish under `zenoh_key` for a message, valid for every process that was heard so far."""
        self._number += 1
        number = self._number.to_bytes(_NUMBER_BYTES, "big")
        sealed = b"".join((self._process, number, self._receivers, message))
        return self._mac(zenoh_key, sealed) + sealed

    def open(self, zenoh_key: str, sealed: bytes) -> bytes:
        """The message that came under `zenoh_key`, to be acted upon.

        Raises:
            ForgedMessageError: if no holder of the key published it there, or it is not newer than the last, or of a
                process whose successor was heard.
            UnboundMessageError: if it was not made for this process; a greeting tells its sender of it.
        """
        message = self.read(zenoh_key, sealed)
        link = self._links.get(zenoh_key) or self._links.setdefault(zenoh_key, _Link())
        sender = sealed[_MAC_BYTES:_NUMBER]
        if sender in link.ended:
            raise ForgedMessageError(f"{zenoh_key}: from a process that another has taken the place of")
        if not self._is_receiver(sealed):
            if sender != link.sender and sender not in link.newcomers:
                link.newcomers.append(sender)
                self._address_all()
            raise UnboundMessageError(f"{zenoh_key}: not made for this process, but for another or before it")
        number = int.from_bytes(sealed[_NUMBER:_COUNT], "big")
        if sender != link.sender:
            if link.sender:
                link.ended.add(link.sender)
            link.sender, link.number = sender, 0
            link.newcomers.clear()
            self._address_all()
        if number <= link.number:
            raise ForgedMessageError(
                f"{zenoh_key}: number {number} again, the newest so far is {link.number}"
            )
        link.number = number
        return message

    def meet(self, zenoh_key: str, sealed: bytes) -> None:
        """Learn of the sender of a greeting: what is closed from now on is valid for it.

        Raises:
            ForgedMessageError: as `open` does.
        """
        with contextlib.suppress(UnboundMessageError):
            self.open(zenoh_key, sealed)

    def read(self, zenoh_key: str, sealed: bytes) -> bytes:
        """The message, for who only watches: it may be old, and another's. Any thread may call this.

        Raises:
            ForgedMessageError: if no holder of the key published it under `zenoh_key`, or it is too long.
        """
        if len(sealed) > MAX_SEALED_BYTES:
            raise ForgedMessageError(
                f"{zenoh_key}: {len(sealed)} bytes, at most {MAX_SEALED_BYTES} are sealed"
            )
        mac, rest = sealed[:_MAC_BYTES], sealed[_MAC_BYTES:]
        if len(sealed) < _RECEIVERS or not compare_digest(mac, self._mac(zenoh_key, rest)):
            raise ForgedMessageError(f"{zenoh_key}: {len(sealed)} bytes without the seal of this realm's key")
        return sealed[_RECEIVERS + _PROCESS_BYTES * sealed[_COUNT] :]

    def _is_receiver(self, sealed: bytes) -> bool:
        at = sealed.find(self._process, _RECEIVERS, _RECEIVERS + _PROCESS_BYTES * sealed[_COUNT])
        return at >= 0 and (at - _RECEIVERS) % _PROCESS_BYTES == 0

    def _address_all(self) -> None:
        """From now on, close messages for all who were heard."""
        known = {process for link in self._links.values() for process in (link.sender, *link.newcomers)}
        receivers = sorted(known - {b""})[:_MOST_RECEIVERS]
        self._receivers = bytes([len(receivers)]) + b"".join(receivers)

    def _mac(self, zenoh_key: str, sealed: bytes) -> bytes:
        name = zenoh_key.encode()
        # its length first, so that no byte can pass from the key into the message
        text = b"".join((len(name).to_bytes(_LENGTH_BYTES, "big"), name, sealed))
        return blake2b(text, digest_size=_MAC_BYTES, key=self._key, person=b"deltaq guarded").digest()
