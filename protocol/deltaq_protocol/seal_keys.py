"""Keys of seals: one that all services of a realm share, or one for each speaker and each of its listeners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import NamedTuple, Protocol

from deltaq_protocol.sayings import sayings

KEY_BYTES = 32
_LENGTH_BYTES = 8


class KnownBy(NamedTuple):
    """How a receiver finds out who sent a message under a zenoh key.

    Attributes:
        key: key of the MAC that is for this receiver.
        place: index of that MAC among the message's MACs, from 0.
        macs: number of MACs of the message.
        speaker: the service that can have made it, for people.
    """

    key: bytes
    place: int
    macs: int
    speaker: str


class SealKeys(Protocol):
    """The keys of one process."""

    def said(self, zenoh_key: str) -> Sequence[bytes]:
        """Keys of the MACs of messages that it publishes under a zenoh key, one for each receiver that checks them."""

    def heard(self, zenoh_key: str) -> KnownBy | None:
        """How it verifies a message under a zenoh key; None if no message there is for it."""


class RealmKey:
    """One key: a process that has it can send every message.

    Args:
        key: the realm's, `KEY_BYTES` long.
    """

    def __init__(self, key: bytes) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"the key has {len(key)} bytes; it must have {KEY_BYTES}")
        self._said = (key,)
        self._heard = KnownBy(key, 0, 1, "a holder of this realm's key")

    def said(self, _zenoh_key: str) -> Sequence[bytes]:
        """The one key."""
        return self._said

    def heard(self, _zenoh_key: str) -> KnownBy | None:
        """The one key."""
        return self._heard


class PairKeys:
    """A key for each sender and receiver, in each direction: the holder of one identity can send only what it may send.

    Args:
        name: the service whose keys these are.
        cell: name of the cell.
        robots: names of its robots.
        secrets: by service, its own included, the 32 bytes that only it and this service can compute.
    """

    def __init__(self, name: str, cell: str, robots: Sequence[str], secrets: Mapping[str, bytes]) -> None:
        self._name = name
        self._said: dict[str, tuple[bytes, ...]] = {}
        self._heard: dict[str, KnownBy] = {}
        for saying in sayings(cell, robots):
            speaker, listeners = saying.speaker, saying.listeners
            if speaker == name:
                keys = tuple(pair_key(secrets[listener], cell, name, listener) for listener in listeners)
                self._said[saying.key] = keys
            if name in listeners:
                key = pair_key(secrets[speaker], cell, speaker, name)
                self._heard[saying.key] = KnownBy(key, listeners.index(name), len(listeners), speaker)

    def said(self, zenoh_key: str) -> Sequence[bytes]:
        """One for each listener of the table.

        Raises:
            ValueError: if the table has this service say nothing there.
        """
        keys = self._said.get(zenoh_key)
        if keys is None:
            raise ValueError(
                f"{self._name} says nothing under {zenoh_key}; it may under {', '.join(self._said)}"
            )
        return keys

    def heard(self, zenoh_key: str) -> KnownBy | None:
        """That of the one speaker that the table has there."""
        return self._heard.get(zenoh_key)


def pair_key(secret: bytes, cell: str, speaker: str, listener: str) -> bytes:
    """The key of what one service says to another: BLAKE2b with their secret over three names, each with its length.

    Args:
        secret: 32 bytes that only the two can compute; the same in both directions.
        cell: name of the cell.
        speaker: name of the service that speaks.
        listener: name of the one that is spoken to.
    """
    names = [name.encode() for name in (cell, speaker, listener)]
    text = b"".join(len(name).to_bytes(_LENGTH_BYTES, "big") + name for name in names)
    return blake2b(text, digest_size=KEY_BYTES, key=secret, person=b"deltaq pair").digest()
