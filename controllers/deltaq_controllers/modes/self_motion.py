"""Self-motion mode: any joint driven, all others move so that the hands stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.avoidance import limit_weights, moves_out
from deltaq_controllers.modes.brake_margin import GLIMPSE_S, kept_while_braked
from deltaq_controllers.modes.hands import Hands, turned
from deltaq_controllers.modes.interface import TeleoperationMode
from deltaq_controllers.modes.limitation import Limit, Limitation
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved_rate import Inverse
from deltaq_protocol.arrays import Array

KEPT_M, KEPT_RAD = 1e-6, 1e-6
"""A step after which a hand is farther off than this is not made [m, rad]."""

TAKEN_BACK_M_S, TAKEN_BACK_RAD_S = 2e-3, 2e-3
"""Greatest rate at which an older error is corrected [m/s, rad/s]."""

_NEWTON_STEPS = 3
_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
"""Parts of a step that are tried, until the hands stay."""


class SelfMotionMode(TeleoperationMode):
    """Moves within the null space of the hands (Hooper & Noakes, section II).

    The hands are held where they were when the mode began: a brake of the gate, which is straight in joint space, may
    move them a little, and the next motion corrects that. A joint that cannot move without the hands does not move.

    Raises:
        ControllerError: the robot is not redundant.
    """

    name = ModeName.SELF_MOTION
    drives_hands = False

    def __init__(self, robot: RobotModel) -> None:
        self._hands = Hands(robot)
        hands = len(self._hands.names)
        if robot.n <= 6 * hands:
            raise ControllerError(
                f"self-motion needs more than {6 * hands} joints for {hands} hand{'s' * (hands > 1)}, robot "
                f"{robot.name!r} has {robot.n}; choose joint, decoupled or coupled"
            )
        self._lower, self._upper = robot.lower, robot.upper
        self._max_acceleration = robot.max_acceleration
        self._names = robot.joint_names
        self.drives_joints = np.ones(robot.n, dtype=np.bool_)
        self._kept = (self._hands.rotations, self._hands.positions)
        self._blocked = False

    def enter(self, q: Array) -> None:
        """Keep the hands where they are."""
        self._hands.update(q)
        self._kept = (self._hands.rotations.copy(), self._hands.positions.copy())

    def bounded(self, q: Array, motion: Motion) -> Motion:
        """The motion, slowed to where the hands stay even if the gate brakes it at any time."""
        rates = self.step(q, motion, GLIMPSE_S) / GLIMPSE_S
        return motion.scaled(kept_while_braked(self._hands, q, rates, self._max_acceleration))

    def step(self, q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement of the joint that is driven, and of those that hold the hands."""
        self._blocked = False
        driven = motion.joints != 0.0
        if not driven.any():
            return np.zeros_like(q)
        for share in _SHARES:
            displacement = self._held(q, driven, share * time_s * motion.joints, time_s)
            if displacement is not None:
                return displacement
        self._blocked = True
        return np.zeros_like(q)

    def _held(self, q: Array, driven: NDArray[np.bool_], own: Array, time_s: float) -> Array | None:
        """The whole displacement for that of the driven joints, or None if the hands would not stay."""
        weights = np.where(driven, 0.0, limit_weights(q, self._lower, self._upper))
        displacement = self._solved(q, own, weights, time_s)
        if displacement is None:
            return None
        out = ~driven & moves_out(q, displacement, self._lower, self._upper)
        if out.any():
            kept_in = self._solved(q, own, np.where(out, 0.0, weights), time_s)
            return displacement if kept_in is None else kept_in
        return displacement

    def _solved(self, q: Array, own: Array, weights: Array, time_s: float) -> Array | None:
        hands = self._hands
        hands.update(q)
        back = _cut(hands.error(*self._kept), time_s)
        goal = turned(hands.rotations, back[:, 3:]), hands.positions + back[:, :3]
        # not damped: the hands stay, or nothing moves
        inverse = Inverse.of(np.where(weights > 0.0, hands.jacobian, 0.0), weights, damping=0.0)
        displacement = own + inverse(back.ravel() - hands.jacobian @ own)
        for _ in range(_NEWTON_STEPS):
            hands.update(q + displacement)
            error = hands.error(*goal)
            off_m, off_rad = np.linalg.norm(error.reshape(-1, 2, 3), axis=2).max(axis=0)
            if off_m < KEPT_M and off_rad < KEPT_RAD:
                return displacement
            displacement = displacement + inverse(error)
        return None

    def limitation(self, _q: Array, motion: Motion) -> Limitation | None:
        """A joint that cannot move while the hands stay."""
        if not self._blocked:
            return None
        names = ", ".join(np.array(self._names)[motion.joints != 0.0])
        return Limitation(Limit.SINGULARITY, names, f"{names} cannot move here without moving the hand")


def _cut(error: Array, time_s: float) -> Array:
    """(h, 6) an error (6 h,) of the hands, clipped to what is corrected within a time."""
    hands = error.reshape(-1, 2, 3).copy()
    sizes = np.linalg.norm(hands, axis=2)
    hands *= np.minimum(
        1.0, time_s * np.array([TAKEN_BACK_M_S, TAKEN_BACK_RAD_S]) / np.maximum(sizes, 1e-15)
    )[:, :, None]
    return hands.reshape(-1, 6)
