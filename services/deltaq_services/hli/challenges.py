"""Challenges that a request of the operator answers, each good once and not for long.

None is kept: the server knows its own by their MAC, so that whoever asks for a million takes nobody's away. Those
that were used are remembered as long as they would be good, and only who knows the operator's token can use one.
"""

from __future__ import annotations

import itertools
import struct
from hashlib import blake2b
from hmac import compare_digest

GOOD_FOR_S = 5.0
"""Between the challenge and the request lies one round trip."""

_MADE = struct.Struct(">dQ")
_MAC_BYTES = 32


class Challenges:
    """Makes challenges, and knows its own again.

    Args:
        secret: different in each process.
    """

    def __init__(self, secret: str) -> None:
        self._key = blake2b(secret.encode(), digest_size=_MAC_BYTES).digest()
        self._counts = itertools.count(1)
        self._used: dict[bytes, float] = {}

    def new(self, time_s: float) -> bytes:
        """A challenge that was never made before; any thread may ask."""
        made = _MADE.pack(time_s, next(self._counts))
        return made + self._mac(made)

    def accept(self, challenge: bytes, time_s: float) -> bool:
        """Whether a challenge is one of this process's, fresh, and was never accepted before."""
        self._used = {used: until_s for used, until_s in self._used.items() if time_s <= until_s}
        if not self.is_new(challenge, time_s):
            return False
        self._used[challenge] = _until_s(challenge)
        return True

    def is_new(self, challenge: bytes, time_s: float) -> bool:
        """Whether `accept` would accept a challenge; nothing is accepted, and any thread may ask."""
        made = challenge[: _MADE.size]
        is_own = len(made) == _MADE.size and compare_digest(self._mac(made), challenge[_MADE.size :])
        return is_own and time_s <= _until_s(challenge) and challenge not in self._used

    def _mac(self, made: bytes) -> bytes:
        return blake2b(made, digest_size=_MAC_BYTES, key=self._key).digest()


def _until_s(challenge: bytes) -> float:
    made_s: float = _MADE.unpack(challenge[: _MADE.size])[0]
    return made_s + GOOD_FOR_S
