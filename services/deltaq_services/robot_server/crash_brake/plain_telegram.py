"""Telegrams read and replies written with bytes and tuples alone, for a process that loads neither numpy nor zenoh.

Both are compiled elsewhere, from the KRC's file: the pattern by `usual_telegram`, the template by `SensorCodec`.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from typing import NamedTuple

MAX_IPOC = 2**32 - 1
_IPOC, _IPOC_ENDS = b"<IPOC>", b"</IPOC>"
_LATE = b'<Delay D="'
_MOST_LATE = 2**62
"""A count that fits into a record, however many digits it was written with."""


class PlainTelegram(NamedTuple):
    """The contents of such a telegram.

    Attributes:
        ipoc: time stamp.
        late: late replies so far, as the controller counts them; 0 if it does not send them.
        programmed: checksum of its programmed position, as it was written; of nothing, if it does not send one.
    """

    ipoc: int
    late: int
    programmed: int


class PlainTelegrams:
    """Reads telegrams of one robot.

    Args:
        pattern: regular expression of a whole telegram.
        elements: beginnings of the elements that hold the programmed position.
        most_bytes: of a telegram.
    """

    def __init__(self, pattern: str, elements: Sequence[str], most_bytes: int) -> None:
        self._match = re.compile(pattern.encode()).fullmatch
        self._elements = tuple(element.encode() for element in elements)
        self._most_bytes = most_bytes

    def read(self, datagram: bytes) -> PlainTelegram | None:
        """Read a datagram; None if it is no telegram of this robot in the usual layout."""
        if len(datagram) > self._most_bytes or self._match(datagram) is None:
            return None
        ipoc = int(datagram[datagram.rindex(_IPOC) + len(_IPOC) : datagram.rindex(_IPOC_ENDS)])
        if ipoc > MAX_IPOC:
            return None
        late, programmed = 0, 0
        if (place := datagram.find(_LATE)) >= 0:
            begins = place + len(_LATE)
            try:
                late = int(float(datagram[begins : datagram.index(b'"', begins)]))
            except ValueError:
                return None
            late = max(-_MOST_LATE, min(late, _MOST_LATE))
        for element in self._elements:
            begins = datagram.index(element)
            programmed = zlib.crc32(datagram[begins : datagram.index(b">", begins)], programmed)
        return PlainTelegram(ipoc, late, programmed)
