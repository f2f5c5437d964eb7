"""Guards of the Robot Server's own, behind the gate: it is the last program before the drives.

They know nothing of bodies. They check that an admission follows the robot's present plan, that no joint
exceeds its velocity or acceleration limit, and that its brake can be driven and ends inside the limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_travel
from deltaq_protocol.guarded import Admission, ServerState
from deltaq_services.containment import Part


class AdmissionsDue(Part):
    """Keeps admissions until their cycle, one for each of the next few; the newest counts.

    Args:
        lookahead_cycles: how many cycles ahead the gate decides, 1 if an admission is due in the next one.
    """

    def __init__(self, lookahead_cycles: int) -> None:
        self._lookahead_cycles = lookahead_cycles
        self._kept: dict[int, Admission] = {}

    def put(self, admission: Admission, cycle: int) -> Refusal | None:
        """Keep an admission, unless it is too old after `cycle` or due later than in the next few."""
        age_cycles, oldest = cycle - admission.cycle, topics.ADMISSION.max_age_cycles or 0
        if not -self._lookahead_cycles < age_cycles <= oldest:
            return Refusal.LATE
        self._kept[max(cycle, admission.cycle)] = admission
        return None

    def take(self, cycle: int) -> Admission | None:
        """Remove and return the admission due in the cycle after `cycle`; earlier ones are dropped."""
        due = self._kept.get(cycle)
        self._kept = {later: kept for later, kept in self._kept.items() if later > cycle}
        return due

    @property
    def kept(self) -> tuple[Admission, ...]:
        """The admissions that wait for their cycle."""
        return tuple(self._kept.values())

    def forget(self) -> int:
        """Keep nothing; returns how many admissions were kept."""
        forgotten = len(self._kept)
        self._kept.clear()
        return forgotten


_SLACK = 1.0 + 1e-6
"""Rounding that a bound tolerates."""


class Refusal(StrEnum):
    """Why the Robot Server did not take an admission; counted under these names."""

    WRONG_EPOCH = "admission_wrong_epoch"
    WRONG_SHAPE = "admission_wrong_shape"
    LATE = "admission_late"
    REPLAYED = "admission_replayed"
    UNCHAINED = "admission_unchained"
    TOO_FAST = "admission_too_fast"
    TOO_ABRUPT = "admission_too_abrupt"
    BRAKE_TOO_ABRUPT = "admission_brake_too_abrupt"
    LEAVES_LIMITS = "admission_leaves_limits"


@dataclass(frozen=True)
class Bounds:
    """Bounds of one robot over one cycle, each (n,) [rad or m]."""

    lower: Array
    upper: Array
    max_dq: Array
    max_dv: Array

    @classmethod
    def of(cls, description: RobotDescription, cycle_s: float) -> Bounds:
        """Bounds of a robot with sample time `cycle_s`."""
        return cls(
            description.lower,
            description.upper,
            description.max_velocity * cycle_s,
            description.max_acceleration * cycle_s**2,
        )


def refusal(admission: Admission, state: ServerState, bounds: Bounds) -> Refusal | None:
    """Why `admission` must not be taken by a robot in `state`, or None if it may.

    Args:
        admission: finite numbers, as the message type guarantees.
        state: the state last published, on which the gate must have decided.
        bounds: the robot's bounds.
    """
    if admission.epoch != state.epoch:
        return Refusal.WRONG_EPOCH
    if len(admission.dq) != len(state.q_cmd):
        return Refusal.WRONG_SHAPE
    if not 0 <= state.cycle - admission.cycle <= (topics.ADMISSION.max_age_cycles or 0):
        return Refusal.LATE
    if admission.sequence <= state.sequence:
        return Refusal.REPLAYED
    follows = (
        admission.follows_sequence,
        admission.follows_q_cmd,
        admission.follows_dq,
        admission.follows_resets,
    )
    if follows != (state.sequence, state.q_cmd, state.dq, state.resets):
        return Refusal.UNCHAINED
    return _motion_refusal(admission, state, bounds)


def _motion_refusal(admission: Admission, state: ServerState, bounds: Bounds) -> Refusal | None:
    dq, last_dq, q_cmd = np.array(admission.dq), np.array(state.dq), np.array(state.q_cmd)
    if (np.abs(dq) > bounds.max_dq * _SLACK).any():
        return Refusal.TOO_FAST
    if (np.abs(dq - last_dq) > bounds.max_dv * _SLACK).any():
        return Refusal.TOO_ABRUPT
    if (np.abs(dq) > admission.brake_cycles * bounds.max_dv * _SLACK).any():
        return Refusal.BRAKE_TOO_ABRUPT
    end = q_cmd + dq + brake_travel(dq, admission.brake_cycles, 0)
    outside = np.maximum(bounds.lower - end, end - bounds.upper)
    outside_now = np.maximum(bounds.lower - q_cmd, q_cmd - bounds.upper)
    # a robot that starts outside its limits may come back, and may not go further out
    if (outside > np.maximum(outside_now, 0.0) + 1e-9).any():
        return Refusal.LEAVES_LIMITS
    return None
