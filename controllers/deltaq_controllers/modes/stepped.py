"""Modes that give the joint displacement of any motion, and the part of it that fits into a cycle (`fit`)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.modes.interface import (
    Advance,
    Instant,
    Limitation,
    Motion,
    TeleoperationMode,
    of_joint,
    of_speed,
)
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.driving import DrivingMode

# The part of an operator's command that fits into one cycle, along the path of the mode.
#
# Clipping joints one by one would take a hand off its line. Here the motion as a whole is slowed: the increment is
# that of a motion between the last one and the one that is commanded, as near to the command as speed,
# acceleration and room to brake allow. Where even the last motion cannot continue, it is slowed down.


RAMP_SHARE = 0.5
"""Fraction of each joint's acceleration that an operator's own changes of speed use."""

_HALVINGS = 8
_SLACK = 1e-9


@dataclass(frozen=True)
class Fit:
    """The motion that fits into a cycle.

    Attributes:
        dq: (n,) increment [rad or m].
        motion: the motion that it makes.
        at_limit: the joint, by number, that has no room left; None if all have.
        too_fast: the joint, by number, that is at its greatest speed.
    """

    dq: Array
    motion: Motion
    at_limit: int | None = None
    too_fast: int | None = None


def fit(
    step: Callable[[Motion], Array],
    previous: Motion,
    commanded: Motion,
    limits: IncrementLimits,
    q_cmd: Array,
    dq_last: Array,
) -> Fit:
    """Find the increment of this cycle.

    Args:
        step: displacement (n,) over the cycle for a motion.
        previous: the motion that the robot makes.
        commanded: the motion that is commanded.
        limits: of the robot.
        q_cmd: (n,) setpoint that the increment is added to [rad or m].
        dq_last: (n,) increment that led to it [rad or m].
    """
    room = _Room(limits, q_cmd, dq_last)
    ahead = step(commanded)
    if room.dynamic(ahead, RAMP_SHARE) and room.blocked(ahead) is None:
        return Fit(ahead, commanded)
    going_on = step(previous)
    found = None
    share = room.largest(going_on, ahead, RAMP_SHARE)
    if share is not None:
        found = _exact(step, room, previous, commanded, share)
    if found is None:
        share = room.largest(np.zeros_like(going_on), going_on, 1.0)
        if share is not None:
            found = _exact(step, room, Motion.rest(*commanded.shape), previous, share)
    if found is None:
        # the path bends too sharply: brake along a straight line, as the gate would
        cycles = brake_cycles(dq_last, limits.max_ddq)
        found = previous.scaled((cycles - 1) / cycles), brake_increment(dq_last, cycles, 1)
    motion, dq = found
    return Fit(limits.admissible(dq, q_cmd, dq_last), motion, room.blocked(ahead), room.fastest(ahead))


def _exact(
    step: Callable[[Motion], Array], room: _Room, previous: Motion, commanded: Motion, share: float
) -> tuple[Motion, Array] | None:
    """The motion at fraction `share`, and its increment; nearer to the last one where a line is a poor guess."""
    for smaller in (1.0, 0.5, 0.25, 0.0):
        motion = previous.towards(commanded, smaller * share)
        dq = step(motion)
        if room.dynamic(dq, 1.0) and room.blocked(dq) is None:
            return motion, dq
    return None


class _Room:
    """The increments that one cycle has room for."""

    def __init__(self, limits: IncrementLimits, q_cmd: Array, dq_last: Array) -> None:
        self._limits, self._q_cmd, self._dq_last = limits, q_cmd, dq_last

    def dynamic(self, dq: Array, share: float) -> bool:
        """Whether speed and `share` of the acceleration suffice."""
        change = np.abs(dq - self._dq_last) - share * self._limits.max_ddq
        speed = np.abs(dq) - self._limits.max_dq
        return bool((change <= _SLACK).all() and (speed <= _SLACK).all())

    def blocked(self, dq: Array) -> int | None:
        """The joint that could not be braked inside its limits, worst first."""
        limits = self._limits
        end = self._q_cmd + dq * (0.5 * (brake_cycles(dq, limits.max_ddq) + 1))
        beyond = np.maximum(end - limits.upper, limits.lower - end)
        # a joint that stands outside may come back
        beyond[
            (np.abs(dq) < _SLACK) | ((dq > 0.0) & (end < limits.lower)) | ((dq < 0.0) & (end > limits.upper))
        ] = 0.0
        joint = int(np.argmax(beyond))
        return joint if beyond[joint] > _SLACK else None

    def fastest(self, dq: Array) -> int | None:
        """Index of the joint that exceeds its velocity limit most; None if none does."""
        share = np.abs(dq) / self._limits.max_dq
        joint = int(np.argmax(share))
        return joint if share[joint] > 1.0 + _SLACK else None

    def largest(self, start: Array, end: Array, share: float) -> float | None:
        """Largest t in [0, 1] for which `start + t (end - start)` fits; None if none does."""
        limits = self._limits
        reach = share * limits.max_ddq
        low = np.maximum(self._dq_last - reach, -limits.max_dq) - _SLACK
        high = np.minimum(self._dq_last + reach, limits.max_dq) + _SLACK
        way = end - start
        still = np.abs(way) < 1e-15
        if (still & ((start < low) | (start > high))).any():
            return None
        way = np.where(still, 1.0, way)
        bounds = np.sort([(low - start) / way, (high - start) / way], axis=0)
        least = float(max(0.0, np.max(bounds[0], where=~still, initial=0.0)))
        most = float(min(1.0, np.min(bounds[1], where=~still, initial=1.0)))
        if least > most:
            return None
        way = end - start
        if self.blocked(start + most * way) is None:
            return most
        if self.blocked(start + least * way) is not None:
            return None
        for _ in range(_HALVINGS):
            middle = 0.5 * (least + most)
            if self.blocked(start + middle * way) is None:
                least = middle
            else:
                most = middle
        return least


class SteppedMode(TeleoperationMode):
    """The common part of `joint` and `advisor`.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._motion = Motion.rest(robot.n, len(robot.hands))
        self._dq: Array = np.zeros(robot.n)

    @abstractmethod
    def step(self, q: Array, motion: Motion, time_s: float, /) -> Array:
        """The joint displacement (n,) for a motion over a time from `q` (n,); zero for no motion."""

    def bounded(self, q: Array, motion: Motion, /) -> Motion:
        """The motion, slowed as far as this mode's guarantee requires at `q` (n,)."""
        del q
        return motion

    def limitation(self, q: Array, motion: Motion, /) -> Limitation | None:
        """The limit of the mode itself that forbids this motion at `q` (n,)."""
        del q, motion
        return None

    def enter(self, q: Array) -> None:
        """Start this mode with the robot at rest at `q` (n,)."""
        self._motion, self._dq = Motion.rest(*self._motion.shape), np.zeros_like(q)

    def advance(self, instant: Instant, asked: Motion) -> Advance:
        """The admissible increment nearest to the requested motion."""
        q, dq_last = instant.q_cmd, instant.dq_last
        wanted = self.bounded(q, asked) if asked else asked
        previous = self._motion.scaled(self._made(dq_last))
        found = fit(
            lambda motion: self.step(q, motion, instant.cycle_s),
            previous,
            wanted,
            instant.limits,
            q,
            dq_last,
        )
        self._motion, self._dq = found.motion, found.dq
        return Advance(found.dq, self._limited(found, q, asked) if asked else None)

    def _made(self, dq_last: Array) -> float:
        """Fraction of the motion last asked for that the robot was commanded: the gate may have braked it."""
        size = float(self._dq @ self._dq)
        return min(1.0, max(0.0, float(self._dq @ dq_last) / size)) if size > 0.0 else 0.0

    def _limited(self, found: Fit, q: Array, asked: Motion) -> Limitation | None:
        own = self.limitation(q, asked)
        if own is not None:
            return own
        names, revolute = self._robot.joint_names, self._robot.revolute
        if found.at_limit is not None:
            joint = found.at_limit
            return of_joint(names[joint], float(q[joint]), bool(revolute[joint]))
        return of_speed(names[found.too_fast]) if found.too_fast is not None else None


# Joint mode: each joint by itself. It needs no inverse, so it works in every configuration.


class JointMode(SteppedMode):
    """Drives joints independently (Hooper & Noakes, section II); only their own limits bound it."""

    name = DrivingMode.JOINT
    drives_hands = False

    def __init__(self, robot: RobotModel) -> None:
        super().__init__(robot)
        self.drives_joints = np.ones(robot.n, dtype=np.bool_)

    def step(self, _q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement asked for."""
        displacement: Array = motion.joints * time_s
        return displacement
