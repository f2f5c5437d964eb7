"""Seals on the messages of the guarded realm, for realms that leave the loopback.

A sealed message is `MAC (32 bytes) | number (8 bytes, big endian) | message`. The MAC is BLAKE2b keyed with the
realm's key (RFC 7693, 2.9) over the zenoh key, the number and the message, so that a message is invalid under
another zenoh key; fields of the message itself bind it to gate epoch, lease epoch, sequence and cycle. Numbers of a
sender only grow, also over its restarts, and each is valid once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from hashlib import blake2b
from hmac import compare_digest

from deltaq_protocol.errors import ProtocolError

KEY_BYTES = 32
_MAC_BYTES = 32
_NUMBER_BYTES = 8
_HEAD_BYTES = _MAC_BYTES + _NUMBER_BYTES


class ForgedMessageError(ProtocolError):
    """A message without the right seal, or a duplicate."""


class Seal:
    """Leaves messages as they are: on the loopback nobody else can speak."""

    def close(self, zenoh_key: str, message: bytes) -> bytes:  # noqa: ARG002 - where there is no key, nothing depends on it
        """The bytes to publish under `zenoh_key` for a message."""
        return message

    def open(self, zenoh_key: str, sealed: bytes) -> bytes:  # noqa: ARG002 - as above
        """The message that came under `zenoh_key`.

        Raises:
            ForgedMessageError: if no holder of the key published it there, or it is not newer than the last.
        """
        return sealed


class KeyedSeal(Seal):
    """Seals published messages and checks received ones; one for each process.

    Each zenoh key has one sender, whose numbers are compared.

    Args:
        key: the realm's, `KEY_BYTES` long.
        now_ns: time since 1970 [ns], from which numbers begin: greater than those of an earlier process.
    """

    def __init__(self, key: bytes, now_ns: Callable[[], int] = time.time_ns) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"the key has {len(key)} bytes; it must have {KEY_BYTES}")
        self._key = key
        self._number = now_ns()
        self._newest: dict[str, int] = {}

    def close(self, zenoh_key: str, message: bytes) -> bytes:
        """The bytes to publish under `zenoh_key` for a message."""
        self._number += 1
        numbered = self._number.to_bytes(_NUMBER_BYTES, "big") + message
        return self._mac(zenoh_key, numbered) + numbered

    def open(self, zenoh_key: str, sealed: bytes) -> bytes:
        """The message that came under `zenoh_key`; see `Seal.open`."""
        mac, numbered = sealed[:_MAC_BYTES], sealed[_MAC_BYTES:]
        if len(sealed) < _HEAD_BYTES or not compare_digest(mac, self._mac(zenoh_key, numbered)):
            raise ForgedMessageError(f"{zenoh_key}: {len(sealed)} bytes without the seal of this realm's key")
        number = int.from_bytes(numbered[:_NUMBER_BYTES], "big")
        newest = self._newest.get(zenoh_key, 0)
        if number <= newest:
            raise ForgedMessageError(f"{zenoh_key}: number {number} again, the newest so far is {newest}")
        self._newest[zenoh_key] = number
        return numbered[_NUMBER_BYTES:]

    def _mac(self, zenoh_key: str, numbered: bytes) -> bytes:
        name = zenoh_key.encode()
        # its length first, so that no byte can pass from the key into the message
        text = len(name).to_bytes(_NUMBER_BYTES, "big") + name + numbered
        return blake2b(text, digest_size=_MAC_BYTES, key=self._key, person=b"deltaq guarded").digest()


UNSEALED = Seal()
