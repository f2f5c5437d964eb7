"""Whether a datagram is the telegram that is expected: machine code, since a KRC waits for what comes after it.

What is known of the next telegram is the one before it, its own IPOC, and where its joints have to be. So it is read
along that text: what stands between the values has to be the same, byte by byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deltaq_cell.compiled import makes_no_array
from deltaq_protocol.arrays import Array, Bytes, Indices

_MOST_DIGITS = 15
"""Of a value. A number of so many digits, and its power of ten, are exact; their quotient is what `float` reads."""

_POWERS = 10.0 ** np.arange(_MOST_DIGITS + 1)
_PLUS, _MINUS, _POINT, _ZERO, _NINE = b"+-.09"


class ExpectedTelegram(NamedTuple):
    """A telegram that is expected.

    Attributes:
        text: (m,) its bytes, with the values of the telegram before it.
        starts, ends: (k,) where in the text the values stand that may be others.
        lower, upper: (k,) what they may be, in the KRC's units; infinite where it makes no difference.
    """

    text: Bytes
    starts: Indices
    ends: Indices
    lower: Array
    upper: Array

    @classmethod
    def of(
        cls, text: bytes, places: Sequence[tuple[int, int]], lower: Array, upper: Array
    ) -> ExpectedTelegram:
        """The telegram with its values at these places, in their order."""
        starts, ends = np.array(places, dtype=np.intp).reshape(-1, 2).T.copy()
        return cls(np.frombuffer(text, dtype=np.uint8), starts, ends, lower, upper)


@makes_no_array
def is_expected(expected: ExpectedTelegram, datagram: Bytes, size: int) -> bool:
    """Whether a datagram is that telegram.

    Args:
        expected: the telegram.
        datagram: (at least size,) its bytes.
        size: their number.

    Returns:
        False too for what is such a telegram, but has a value with an exponent or with more than 15 digits.
    """
    text, place, here = expected.text, 0, 0
    for value in range(len(expected.starts) + 1):
        is_last = value == len(expected.starts)
        until = len(text) if is_last else expected.starts[value]
        while place < until:
            if here >= size or datagram[here] != text[place]:
                return False
            place, here = place + 1, here + 1
        if is_last:
            break
        sign = 1.0
        if here < size and (datagram[here] == _PLUS or datagram[here] == _MINUS):
            sign = -1.0 if datagram[here] == _MINUS else 1.0
            here += 1
        number, digits, decimals = 0, 0, -1
        while here < size:
            character = datagram[here]
            if _ZERO <= character <= _NINE and digits < _MOST_DIGITS:
                number = 10 * number + (character - _ZERO)
                digits += 1
                decimals += decimals >= 0
            elif character == _POINT and decimals < 0 < digits:
                decimals = 0
            else:
                break
            here += 1
        told = sign * (number / _POWERS[max(decimals, 0)])
        if digits == 0 or not expected.lower[value] <= told <= expected.upper[value]:
            return False
        place = expected.ends[value]
    return here == size
