"""Motion of increments that came after their turn: it goes out with those behind them, a little in each cycle.

In a cycle without an increment the robot brakes, but it moves on meanwhile. So of an increment that comes a cycle late
only the rest is owed: what was asked for, less what the brake has gone already. The rest is spread over some cycles,
since all of it at once would be more than a joint can accelerate.

Pure: cycles and increments are handed in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array

SPREAD_CYCLES = 8
"""In each cycle one part in so many of what is owed goes out. The speed is then greater by an eighth for an increment
that is owed, and comes back by itself. All at once, or evenly until it is gone, asks for more than joints can brake."""

_CARRIED_FOR_CYCLES = 5 * SPREAD_CYCLES
"""After so many cycles less than a hundredth is left, and goes out whole."""

MOST_CARRIED_CYCLES = 12
"""Increments whose turn was longer ago are refused: what they were for has passed. No more than so many of the greatest
increments is ever owed."""


@dataclass(frozen=True, slots=True)
class CarriedMemory:
    """Snapshot of a `CarriedMotion`."""

    owed: tuple[float, ...]
    cycles_left: int
    unasked: tuple[float, ...]
    unasked_cycles: int


class CarriedMotion:
    """The motion that was requested of one robot and not sent yet, and the motion that it made unasked.

    Args:
        max_dq: (n,) largest increment [rad or m].
        max_dv: (n,) largest change of it from one cycle to the next [rad or m].
    """

    def __init__(self, max_dq: Array, max_dv: Array) -> None:
        self._max_dq, self._max_dv = max_dq, max_dv
        self.forget()

    @classmethod
    def of(cls, robot: RobotDescription, cycle_s: float) -> CarriedMotion:
        """That of a robot with sample time `cycle_s`."""
        return cls(robot.max_velocity * cycle_s, robot.max_acceleration * cycle_s**2)

    @property
    def owed(self) -> tuple[float, ...] | None:
        """(n,) motion still to go out [rad or m]; None if there is none."""
        owed = self._owed - self._unasked
        return tuple(owed.tolist()) if owed.any() else None

    def asked(self, dq: Sequence[float]) -> None:
        """An increment (n,) has no turn of its own any more: its motion is owed, as far as one cycle can have it."""
        self._owe(np.array(dq, dtype=np.float64).clip(-self._max_dq, self._max_dq))

    def moved(self, dq: Array, cycles: int) -> None:
        """The robot moved by (n,) in so many cycles that had no increment, since one had its turn [rad or m]."""
        self._unasked, self._unasked_cycles = dq, cycles

    def settle(self, missing: int) -> None:
        """An increment has its turn again: motion that was made unasked is owed back.

        It is not for as many cycles as increments are missing that will never come.
        """
        if self._unasked.any() and missing < self._unasked_cycles:
            self._owe(-self._unasked * (1.0 - missing / self._unasked_cycles))
        self._unasked, self._unasked_cycles = np.zeros_like(self._max_dq), 0

    def forget(self) -> None:
        """Nothing is owed any more."""
        self._owed, self._cycles_left = np.zeros_like(self._max_dq), 0
        self._unasked, self._unasked_cycles = np.zeros_like(self._max_dq), 0

    def add_to(self, dq: Sequence[float], last_dq: Sequence[float] | None) -> tuple[float, ...]:
        """The increment whose turn it is, plus a part of the owed motion; unchanged if no motion is owed.

        A robot that has braked returns to its speed as fast as its limits allow, and the motion missed meanwhile is
        owed too. All owed motion finally goes to the gate, which scales a sum that is too large, and reports this. An
        increment that is too large for any cycle goes to the gate by itself.

        Args:
            dq: (n,) the increment [rad or m].
            last_dq: (n,) the increment sent before [rad or m]; None if it is not known.

        Returns:
            (n,) what to ask the gate for.
        """
        asked = np.array(dq, dtype=np.float64)
        if not self._cycles_left or (np.abs(asked) > self._max_dq).any():
            return tuple(dq)
        self._cycles_left -= 1
        share = self._owed / SPREAD_CYCLES if self._cycles_left else self._owed
        wanted, self._owed = asked + share, self._owed - share
        if self._cycles_left and last_dq is not None:
            last = np.array(last_dq, dtype=np.float64)
            slowest = np.maximum(-self._max_dq, last - self._max_dv)
            fastest = np.minimum(self._max_dq, last + self._max_dv)
            reached = wanted.clip(slowest, fastest)
            self._owed = self._bounded(self._owed + (wanted - reached))
            wanted = reached
        return tuple(wanted.tolist())

    def snapshot(self) -> CarriedMemory:
        """Snapshot for `restore`."""
        owed, unasked = tuple(self._owed.tolist()), tuple(self._unasked.tolist())
        return CarriedMemory(owed, self._cycles_left, unasked, self._unasked_cycles)

    def restore(self, memory: CarriedMemory) -> None:
        """Go on from where another was."""
        self._owed, self._unasked = np.array(memory.owed), np.array(memory.unasked)
        self._cycles_left, self._unasked_cycles = memory.cycles_left, memory.unasked_cycles

    def _owe(self, dq: Array) -> None:
        self._owed = self._bounded(self._owed + dq)
        self._cycles_left = _CARRIED_FOR_CYCLES

    def _bounded(self, owed: Array) -> Array:
        most = MOST_CARRIED_CYCLES * self._max_dq
        return owed.clip(-most, most)
