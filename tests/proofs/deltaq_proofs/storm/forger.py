"""What an attacker on RSI's wire sends: made from the true telegrams that it overhears, or from nothing."""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

_IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
_IPOCS = 2**32
_OVERHEARD = 20
_STEP = 12
"""What the attacker lets a clock of its own grow by."""
_ROOM = 60_000
"""Bytes of an oversized datagram, at most."""


class ForgedSender(StrEnum):
    """Whose address a datagram carries."""

    KRC = "the KRC"
    SECOND_KRC = "a second KRC"
    STRANGER = "a stranger"


class ForgedDatagram(NamedTuple):
    """One datagram of the attacker."""

    kind: str
    sender: ForgedSender
    datagram: bytes


class Forger:
    """Makes forgeries, as a seed decides; most of them come from elsewhere or cannot be read.

    Those that can, and seem to be the KRC's own, are rare: each of them costs the KRC an answer, and one without
    answers stops by itself.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._overheard: deque[bytes] = deque(maxlen=_OVERHEARD)
        self._ipoc = self._random.randrange(_IPOCS)
        make: dict[str, tuple[float, ForgedSender, Callable[[], bytes]]] = {
            "copy from elsewhere": (150, ForgedSender.STRANGER, self._own),
            "next from elsewhere": (100, ForgedSender.STRANGER, self._next_moved),
            "copy of a second KRC": (100, ForgedSender.SECOND_KRC, self._own),
            "session of a second KRC": (250, ForgedSender.SECOND_KRC, self._session),
            "noise": (50, ForgedSender.STRANGER, self._noise),
            "own noise": (50, ForgedSender.KRC, self._noise),
            "truncated": (120, ForgedSender.KRC, self._truncated),
            "garbled": (120, ForgedSender.KRC, self._garbled),
            "duplicate": (10, ForgedSender.KRC, self._own),
            "overtaken": (8, ForgedSender.KRC, self._older),
            "oversized": (40, ForgedSender.KRC, self._oversized),
            "empty": (10, ForgedSender.KRC, lambda: b""),
            "another digit": (2, ForgedSender.KRC, lambda: self._other_digit(self._own())),
            "far": (1, ForgedSender.KRC, lambda: self._with_ipoc(self._own(), 12 * self._random.randrange(2, 10**6))),
            "back": (2, ForgedSender.KRC, lambda: self._with_ipoc(self._own(), -self._random.randrange(1, 5000))),
            "next": (0.5, ForgedSender.KRC, lambda: self._with_ipoc(self._own(), _STEP)),
            "next elsewhere": (0.5, ForgedSender.KRC, self._next_moved),
            "next with another digit": (1, ForgedSender.KRC, lambda: self._other_digit(self._next())),
            "session from elsewhere": (0.2, ForgedSender.KRC, self._session),
        }  # fmt: skip
        self._make = make
        self._kinds = list(make)
        self._weights = [weight for weight, _, _ in make.values()]

    def overhear(self, telegram: bytes) -> None:
        """A true telegram has passed."""
        self._overheard.append(telegram)

    def forge(self) -> ForgedDatagram | None:
        """The next datagram; None while nothing was overheard."""
        if not self._overheard:
            return None
        (kind,) = self._random.choices(self._kinds, self._weights)
        _, sender, make = self._make[kind]
        return ForgedDatagram(kind, sender, make())

    def chance(self, share: float) -> bool:
        """Whether something happens that happens to this share."""
        return self._random.random() < share

    def _own(self) -> bytes:
        return self._overheard[-1]

    def _older(self) -> bytes:
        return self._random.choice(self._overheard)

    def _next(self) -> bytes:
        return self._with_ipoc(self._own(), _STEP)

    def _next_moved(self) -> bytes:
        """The next cycle's, from a robot that seems to stand up to a few degrees away."""
        shift = self._random.gauss(0.0, 1.5)

        def moved(match: re.Match[bytes]) -> bytes:
            return b'%s"%.4f"' % (match[1], float(match[2]) + shift)

        head, axes, rest = self._next().partition(b"<AIPos")
        axis, _, tail = rest.partition(b"/>")
        return head + axes + re.sub(rb'( A\d=)"([^"]+)"', moved, axis) + b"/>" + tail

    def _session(self) -> bytes:
        """Of a clock of its own, standing still: each agrees with the one before."""
        self._ipoc = (self._ipoc + _STEP) % _IPOCS
        if self.chance(0.01):
            self._ipoc = self._random.randrange(_IPOCS)
        return _IPOC.sub(b"<IPOC>%d</IPOC>" % self._ipoc, self._overheard[0])

    def _truncated(self) -> bytes:
        own = self._own()
        return own[: self._random.randrange(len(own))]

    def _garbled(self) -> bytes:
        own = bytearray(self._next())
        for _ in range(self._random.randint(1, 4)):
            own[self._random.randrange(len(own))] = self._random.randrange(256)
        return bytes(own)

    def _other_digit(self, own: bytes) -> bytes:
        places = [place for place, byte in enumerate(own) if 0x30 <= byte <= 0x39]
        place = self._random.choice(places)
        return own[:place] + b"%d" % self._random.randrange(10) + own[place + 1 :]

    def _oversized(self) -> bytes:
        return self._own() + b" " * self._random.randrange(4096, _ROOM)

    def _noise(self) -> bytes:
        return self._random.randbytes(self._random.randrange(1, 1400))

    @staticmethod
    def _with_ipoc(own: bytes, ahead: int) -> bytes:
        return _IPOC.sub(lambda match: b"<IPOC>%d</IPOC>" % ((int(match[1]) + ahead) % _IPOCS), own)
