"""Faults of the lines in a byte stream: each line is lost, duplicated or overtaken as a whole."""

from __future__ import annotations

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_verification.impairment.stream import MAX_WAITING_BYTES


class FaultyLines:
    """One direction of a connection that carries a message a line.

    Args:
        seed: of the random numbers that decide what happens to which line.
    """

    def __init__(self, seed: int = 0) -> None:
        self._link = FaultyLink(seed)
        self._begun = bytearray()

    @property
    def faults(self) -> LinkFaults:
        """Faults of the lines; may be set at any time."""
        return self._link.faults

    @faults.setter
    def faults(self, faults: LinkFaults) -> None:
        self._link.faults = faults

    @property
    def waiting_bytes(self) -> int:
        """Bytes of an unfinished line; the link bounds the others."""
        return len(self._begun)

    def put(self, now_s: float, chunk: bytes) -> None:
        """Bytes enter; a line is sent on when its end has come, or when it is too long to be one."""
        *whole, rest = (self._begun + chunk).split(b"\n")
        for line in whole:
            self._link.put(now_s, bytes(line) + b"\n")
        self._begun = rest
        if len(rest) >= MAX_WAITING_BYTES:
            self._link.put(now_s, bytes(rest))
            self._begun = bytearray()

    def take(self, now_s: float) -> list[bytes]:
        """The lines that leave by now."""
        return self._link.take(now_s)

    @property
    def next_s(self) -> float | None:
        """When the next line leaves, or None if there is none."""
        return self._link.next_s
