"""Pulses of a probe that another session of the KRC cut short: the next setpoint in the first session undoes them.

Without that each would be part of where the session after it begins, and whoever can begin sessions could walk the
robot by as many pulses as they like, though nothing was admitted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from deltaq_protocol.arrays import Array

SESSIONS = 64
"""Sessions that are remembered: a KRC that comes back after another was believed has its own correction still."""

_Pair = tuple[tuple[float, ...], tuple[float, ...]]
_SAME = 1e-9
"""Differences that rounding makes of one setpoint [rad or m]."""


@dataclass(frozen=True, slots=True)
class PulsesMemory:
    """Snapshot of `PulsesCutShort`: setpoints with a pulse, and without it [rad or m]."""

    last: _Pair | None
    cut: tuple[_Pair, ...]


class PulsesCutShort:
    """What the KRC was sent in each session, and what it was without the pulse of a probe."""

    def __init__(self) -> None:
        self._last: _Pair | None = None
        self._cut: deque[_Pair] = deque(maxlen=SESSIONS)

    def sent(self, q_cmd: Array, setpoint: Array) -> None:
        """A reply: `q_cmd` (n,) was sent, which is the `setpoint` (n,) and what a probe adds to it [rad or m]."""
        self._last = tuple(q_cmd.tolist()), tuple(setpoint.tolist())

    def cut_short(self) -> None:
        """Another session begins."""
        if self._last is not None:
            self._cut.append(self._last)
        self._last = None

    def undone(self, q_start: Array) -> Array:
        """The setpoint (n,) of a session that goes on from `q_start` (n,), without the pulse that it was left with."""
        for q_cmd, setpoint in reversed(self._cut):
            if (np.abs(np.array(q_cmd) - q_start) <= _SAME).all():
                return np.array(setpoint)
        return q_start

    def snapshot(self) -> PulsesMemory:
        """Snapshot for `restore`."""
        return PulsesMemory(self._last, tuple(self._cut))

    def restore(self, memory: PulsesMemory) -> None:
        """Go on from where another was."""
        self._last, self._cut = memory.last, deque(memory.cut, maxlen=SESSIONS)
