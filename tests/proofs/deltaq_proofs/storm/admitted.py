"""What a gate has admitted, as far as it was heard: which admission explains a step, and which were not heard."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.guarded import Admission

ROUNDING = 2e-8
"""What six decimals of a degree may add to a difference of two corrections [rad or m]."""
_IN_FLIGHT = 2000
"""Admissions after the last one taken among which the next is looked for: those not taken were late or refused."""


class Admitted:
    """Admissions to one robot, each of which explains one step, in the order of their sequence.

    The gate numbers all that it admits without a gap. A number that is missing is an admission that was lost on its
    way to the listener; it may explain a step that one admission can make, and no other.

    Args:
        admissions: all that were heard of one gate, to every robot, in any order.
        robot: the robot's name; description: its limits; cycle_s: sample time.

    Attributes:
        unheard: numbers that are missing, in their order.
    """

    def __init__(
        self, admissions: Sequence[Admission], robot: str, description: RobotDescription, cycle_s: float
    ) -> None:
        heard = sorted(one.sequence for one in admissions)
        everything = range(heard[0], heard[-1] + 1) if heard else range(0)
        self.unheard = sorted(set(everything).difference(heard))
        own = sorted((one for one in admissions if one.robot == robot), key=lambda one: one.sequence)
        self._sequences = np.array([one.sequence for one in own])
        self._follows = np.array([one.follows_q_cmd for one in own])
        self._dq = np.array([one.dq for one in own])
        self._brake_cycles = [one.brake_cycles for one in own]
        self._max_dq = description.max_velocity * cycle_s
        self._max_dv = description.max_acceleration * cycle_s**2
        self._newest = -1

    def take(self, setpoint: Array, moved: Array) -> list[Array] | None:
        """Take the first heard admission not yet passed that follows a setpoint (n,) and moves by `moved` (n,).

        Returns:
            The increments of its brake; None if there is no such admission.
        """
        first = int(np.searchsorted(self._sequences, self._newest, side="right"))
        window = slice(first, first + _IN_FLIGHT)
        off = np.maximum(np.abs(self._follows[window] - setpoint), np.abs(self._dq[window] - moved))
        found = np.flatnonzero((off <= 2 * ROUNDING).all(axis=1)).tolist() if len(off) else []
        if not found:
            return None
        taken = first + found[0]
        self._newest = int(self._sequences[taken])
        return _brake(self._dq[taken], self._brake_cycles[taken])

    def take_unheard(self, before: Array, moved: Array) -> list[Array] | None:
        """Take the first unheard admission, if one admission can move by `moved` (n,) after a step `before` (n,).

        Returns:
            The increments of its brake; None if no number is missing, or the step is beyond the robot's limits.
        """
        missing = [one for one in self.unheard if self._newest < one <= self._newest + _IN_FLIGHT]
        changes = (
            np.abs(moved - before),
            np.abs(moved),
        )  # after silence of its KRC a robot goes on from rest
        possible = any((change <= self._max_dv + 2 * ROUNDING).all() for change in changes)
        if not missing or not possible or (np.abs(moved) > self._max_dq + ROUNDING).any():
            return None
        self._newest = missing[0]
        # rounding must not make the brake of a whole number of steps longer than it is
        return _brake(moved, brake_cycles(np.maximum(np.abs(moved) - ROUNDING, 0.0), self._max_dv))


def _brake(dq: Array, cycles: int) -> list[Array]:
    return [brake_increment(dq, cycles, step) for step in range(1, cycles)]
