"""Whether a key is tapped or held, from a terminal that reports presses and repeats alike and no release.

A held key is repeated after a first delay of 0.25 to 0.66 s and then some 10 to 30 times a second, as the operator's
desktop is set. So the first press moves slowly for as long as that delay may take, and the key counts as held from the
second repeat on: then it moves at full speed, and stops soon after the last repeat.
"""

from __future__ import annotations

FIRST_REPEAT_S = 0.7
"""Longest time from a press to its first repeat."""

HOLD_S = 0.2
"""How long a repeat moves: the longest motion at full speed after a key was let go, before the robot brakes."""

TAP_S = 0.1
"""A tap moves as far as full speed does in this time."""

TAP_SHARE = TAP_S / FIRST_REPEAT_S
"""Fraction of the speed until a key counts as held."""

_HELD_FROM = 3
"""The press, its first repeat, and the next one: two taps are no hold."""


class HeldKey:
    """The key pressed last, and how fast it moves."""

    def __init__(self) -> None:
        self._key = ""
        self._presses = 0
        self._until_s = 0.0

    def press(self, key: str, time_s: float) -> None:
        """A press or a repeat of a key at a time [s]."""
        is_repeat = key == self._key and time_s < self._until_s
        self._presses = self._presses + 1 if is_repeat else 1
        self._key, self._until_s = key, time_s + (HOLD_S if is_repeat else FIRST_REPEAT_S)

    def release(self) -> None:
        """Release the key that is held."""
        self._key, self._presses = "", 0

    def share(self, time_s: float) -> float:
        """Fraction of the full speed at a time [s]; 0 is rest."""
        if not self._presses or time_s >= self._until_s:
            return 0.0
        return 1.0 if self._presses >= _HELD_FROM else TAP_SHARE
