"""The last steps before a prepared reply is sent, as machine code: what the guard and the record have to say."""

from __future__ import annotations

from deltaq_cell.compiled import makes_no_array
from deltaq_protocol.arrays import Array, Bytes

_POLYNOMIAL = 0xEDB88320
_ALL_BITS = 0xFFFFFFFF


@makes_no_array
def allows(correction: Array, lower: Array, upper: Array) -> bool:
    """Whether a correction may be sent; what is no number may not.

    Args:
        correction: (n,) [rad or m].
        lower: (n,) of `ReplyBounds` [rad or m].
        upper: (n,) of the same.
    """
    if not len(lower) == len(correction) == len(upper):
        return False
    for joint in range(len(correction)):  # noqa: SIM110  # numba compiles no generator
        if not lower[joint] <= correction[joint] <= upper[joint]:
            return False
    return True


@makes_no_array
def continued_checksum(checksum: int, data: Bytes) -> int:
    """CRC-32 of bytes (n,) behind others with that checksum: `zlib.crc32`, which only Python can call."""
    remainder = checksum ^ _ALL_BITS
    for byte in data:
        remainder ^= byte
        for _ in range(8):
            is_odd = remainder & 1
            remainder >>= 1
            if is_odd:
                remainder ^= _POLYNOMIAL
    return remainder ^ _ALL_BITS
