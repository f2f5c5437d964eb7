"""The pulses by which a Robot Server finds out the mode of a session: the one motion that no gate admits."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.arrays import Array


class Pulses:
    """Knows the pulses of a session's trials, each from rest to rest, positive or negative.

    Which sign is due is not asked: a telegram that is answered out of turn may cut a pulse in two. None begins before
    the one before it has been taken back, so that all of them together lead no further than one.

    Args:
        offsets: (k, n) what a positive one adds to the setpoint, cycle by cycle [rad or m].
        within: what rounding may add to a difference of two of them [rad or m].
    """

    def __init__(self, offsets: Array, within: float) -> None:
        self._offsets = offsets
        rest = np.zeros((1, offsets.shape[1]))
        self._steps = np.diff(np.concatenate([rest, offsets, rest]), axis=0)
        self._within = within
        self._next: list[Array] = []
        self._away = np.zeros(offsets.shape[1])

    def begin(self, correction: Array) -> bool:
        """A session begins, or a telegram of another one is answered in the middle of a trial.

        Args:
            correction: (n,) of the first reply.

        Returns:
            Whether a pulse is under way there, which then goes on.
        """
        for sign in (1.0, -1.0):
            for done, offset in enumerate(self._offsets, 1):
                if np.any(offset) and self._near(correction, sign * offset):
                    self._away = sign * offset
                    self._next = [sign * step for step in self._steps[done:]]
                    return True
        self._end()
        return False

    def explains(self, moved: Array) -> bool:
        """Whether the pulse goes on with a step (n,), ends early with it, or begins with it at rest."""
        if self._next and self._near(moved, self._next[0]):
            self._step(self._next)
            return True
        if self._away.any():
            if self._near(moved, -self._away):  # a mode that is refused ends its trial
                self._end()
                return True
            return False
        for sign in (1.0, -1.0):
            steps = [sign * step for step in self._steps]
            if self._near(moved, steps[0]):
                self._step(steps)
                return True
        return False

    def __str__(self) -> str:
        return f"{self._away.tolist()} by a pulse with {len(self._next)} steps to go"

    def _end(self) -> None:
        self._next = []
        self._away = np.zeros_like(self._away)

    def _step(self, steps: list[Array]) -> None:
        self._away = self._away + steps[0]
        self._next = steps[1:]
        if self._near(self._away, np.zeros_like(self._away)):
            self._end()

    def _near(self, one: Array, other: Array) -> bool:
        return bool((np.abs(one - other) <= self._within).all())
