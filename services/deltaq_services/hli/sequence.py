"""Sequence numbers that were seen: none is taken twice, and those of a long way may overtake one another."""

from __future__ import annotations


class Sequence:
    """Which of the newest sequence numbers of a lease were seen; the sliding window of RFC 4303, 3.4.3.

    Args:
        width: how many of the newest are told apart; 1: only a greater number than all before is new.

    Attributes:
        width: as given.
        newest: greatest number seen, -1 before the first.
    """

    def __init__(self, width: int = 1) -> None:
        self.width = width
        self.newest = -1
        self._seen = 0  # bit k: newest - k

    def take(self, number: int) -> bool:
        """A number has come; whether it is new."""
        if number > self.newest:
            self._seen = (self._seen << min(number - self.newest, self.width) | 1) & ~(-1 << self.width)
            self.newest = number
            return True
        behind = self.newest - number
        if behind >= self.width or self._seen >> behind & 1:
            return False
        self._seen |= 1 << behind
        return True

    def copy(self) -> Sequence:
        """One that counts on by itself."""
        copied = Sequence(self.width)
        copied.newest, copied._seen = self.newest, self._seen
        return copied
