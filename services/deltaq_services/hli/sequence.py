"""Sequence numbers that were seen: none is taken twice, and those of a long way may overtake one another."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Sequence:
    """Which of the newest sequence numbers of a lease were seen; the sliding window of RFC 4303, 3.4.3.

    Attributes:
        width: how many of the newest are told apart; 1: only a greater number than all before is new.
        newest: greatest number seen, -1 before the first.
        seen: bit k says that `newest` - k was seen.
    """

    width: int = 1
    newest: int = -1
    seen: int = 0

    def is_new(self, number: int) -> bool:
        """Whether a number may still come."""
        behind = self.newest - number
        return behind < 0 or (behind < self.width and not self.seen >> behind & 1)

    def take(self, number: int) -> bool:
        """A number has come; whether it is new."""
        if not self.is_new(number):
            return False
        if number > self.newest:
            self.seen = (self.seen << min(number - self.newest, self.width) | 1) & ~(-1 << self.width)
            self.newest = number
        else:
            self.seen |= 1 << self.newest - number
        return True
