"""Identities of a cell, as `deltaq keys` makes them, and who has one and lies."""

from __future__ import annotations

import itertools
import secrets
from datetime import timedelta
from hashlib import blake2b
from pathlib import Path

from deltaq_protocol.certified.authority import make_identities
from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.certified.identity import Identity
from deltaq_protocol.sayings import sayings, services
from deltaq_protocol.seal_keys import pair_key

ROBOTS = ("fr", "gr")


def make(to: Path, cell="lab", robots=ROBOTS, people=(), age=timedelta(0), **options) -> Path:
    """Identities that were made some time ago."""
    make_identities(cell, to, services(robots), people, now_utc() - age, **options)
    return to


class Traitor:
    """Makes messages with every key that one identity gives it, written from the documented format alone.

    Args:
        folder: of the identity that it has.
        cell, robots: the cell's.
    """

    def __init__(self, folder: Path, cell="lab", robots=ROBOTS):
        identity = Identity.read(folder, now_utc())
        self.name = identity.name
        pairs = {
            (speaker, listener)
            for service in services(robots)
            for speaker, listener in itertools.permutations((self.name, service), 2)
        } | {(self.name, self.name)}
        self.keys = {}
        for speaker, listener in sorted(pairs):
            other = speaker if listener == self.name else listener
            secret = identity.secret_with(other, now_utc())
            self.keys[speaker, listener] = pair_key(secret, cell, speaker, listener)
        self._count = {row.key: len(row.listeners) for row in sayings(cell, robots)}
        self._process = secrets.token_bytes(8)
        self._number = 0
        self.processes: list[bytes] = []

    def overhear(self, key: str, sealed: bytes) -> None:
        """Learn the numbers of the process that spoke and of those that it spoke to; they are not hidden."""
        if key not in self._count:
            return
        body = sealed[32 * self._count[key] :]
        receivers = [body[17 + 8 * k : 25 + 8 * k] for k in range(body[16])]
        for process in (body[:8], *receivers):
            if process not in self.processes:
                self.processes.append(process)

    def says(self, zenoh_key: str, message: bytes) -> list[bytes]:
        """A message for all processes that were overheard, once with each key in the place of every MAC."""
        return [self.sealed(zenoh_key, message, key) for key in self.keys.values()]

    def sealed(self, zenoh_key: str, message: bytes, key: bytes) -> bytes:
        self._number += 1
        receivers = bytes([len(self.processes)]) + b"".join(self.processes)
        body = self._process + self._number.to_bytes(8, "big") + receivers + message
        text = len(zenoh_key).to_bytes(8, "big") + zenoh_key.encode() + body
        mac = blake2b(text, digest_size=32, key=key, person=b"deltaq guarded").digest()
        return mac * self._count[zenoh_key] + body
