"""Decoupled Cartesian mode: base joints one by one, the six joints next to each hand by the hand's motion."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.hands import Hands, turned
from deltaq_controllers.modes.interface import TeleoperationMode
from deltaq_controllers.modes.limitation import Limitation, of_conditioning
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved_rate import Inverse
from deltaq_controllers.modes.singularity_slowdown import slowed
from deltaq_protocol.arrays import Array


class DecoupledMode(TeleoperationMode):
    """The classic mode of teleoperation (Hooper & Noakes, section II).

    A base joint carries its hands along. The arms' displacement is found by Newton's method, so that a hand that is
    moved along a line stays on it; near a singularity the direction that is lost is damped and the others are kept.
    """

    name = ModeName.DECOUPLED
    drives_hands = True

    def __init__(self, robot: RobotModel) -> None:
        self._hands = Hands(robot)
        self._arms = self._hands.arms.any(axis=0)
        self.drives_joints = np.logical_not(self._arms)

    def bounded(self, q: Array, motion: Motion) -> Motion:
        """The motion, slowed towards singularities and the edge of an arm's reach."""
        return slowed(self._hands, self._inverse_at, q, motion)

    def _inverse_at(self, q: Array) -> Inverse:
        self._hands.update(q)
        return Inverse.of(self._hands.jacobian * self._arms)

    def step(self, q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement of base and arms."""
        base = np.where(self._arms, 0.0, motion.joints) * time_s
        if not motion.hands.any():
            return base
        hands = self._hands
        inverse = self._inverse_at(q + base)
        wanted = motion.hands * time_s
        rotations = turned(hands.rotations, wanted[:, 3:])
        positions = hands.positions + wanted[:, :3]
        arms = inverse(wanted.ravel())
        hands.update(q + base + arms)
        # the part that the damping omits comes back as an error, and is omitted again
        arms += inverse(hands.error(rotations, positions))
        return base + arms

    def limitation(self, q: Array, motion: Motion) -> Limitation | None:
        """A singularity of an arm or the edge of its reach."""
        if not motion.hands.any():
            return None
        return of_conditioning(self._hands, self._inverse_at(q), motion.hands.ravel(), q)
