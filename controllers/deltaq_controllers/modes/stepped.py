"""A mode that gives the joint displacement of any motion: what fits into a cycle is found by `speed_scaling`."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes import speed_scaling
from deltaq_controllers.modes.interface import Advance, Instant, TeleoperationMode
from deltaq_controllers.modes.limitation import Limitation, of_joint, of_speed
from deltaq_controllers.modes.motion import Motion
from deltaq_protocol.arrays import Array


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
        """The limit of the mode itself that keeps it from this motion at `q` (n,)."""
        del q, motion
        return None

    def enter(self, q: Array) -> None:
        """The robot stands at `q` (n,), and no motion goes on."""
        self._motion, self._dq = Motion.rest(*self._motion.shape), np.zeros_like(q)

    def advance(self, instant: Instant, asked: Motion) -> Advance:
        """The increment that is nearest to the requested motion."""
        q, dq_last = instant.q_cmd, instant.dq_last
        wanted = self.bounded(q, asked) if asked else asked
        previous = self._motion.scaled(self._made(dq_last))
        found = speed_scaling.fit(
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

    def _limited(self, found: speed_scaling.Fit, q: Array, asked: Motion) -> Limitation | None:
        own = self.limitation(q, asked)
        if own is not None:
            return own
        names, revolute = self._robot.joint_names, self._robot.revolute
        if found.at_limit is not None:
            joint = found.at_limit
            return of_joint(names[joint], float(q[joint]), bool(revolute[joint]))
        return of_speed(names[found.too_fast]) if found.too_fast is not None else None
