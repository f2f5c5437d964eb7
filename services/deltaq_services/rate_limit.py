"""How many messages one sender may send: so many a second, and as many at once."""

from __future__ import annotations


class RateLimit:
    """A bucket that fills with time and from which each message takes one.

    Args:
        most_s: messages a second.
        at_once: the most at once; as many as in a second if it is not given.

    Attributes:
        most_s: as given.
    """

    def __init__(self, most_s: float, at_once: float | None = None) -> None:
        self.most_s = most_s
        self._full = most_s if at_once is None else at_once
        self._left = self._full
        self._at_s: float | None = None

    def snapshot(self) -> tuple[float, float | None]:
        """What is left, and since when, for `restore`."""
        return self._left, self._at_s

    def restore(self, memory: tuple[float, float | None]) -> None:
        """Go on from where another was."""
        self._left, self._at_s = memory

    def has_left(self, now_s: float) -> bool:
        """Whether one more would be allowed now."""
        since_s = 0.0 if self._at_s is None else now_s - self._at_s
        return self._left + since_s * self.most_s >= 1.0

    def take(self, now_s: float) -> bool:
        """Whether one more is allowed now."""
        if self._at_s is not None:
            self._left = min(self._full, self._left + (now_s - self._at_s) * self.most_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
