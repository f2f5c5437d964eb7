"""Self-motion mode: any joint driven, all others move so that the hands stay."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.brake_margin import allowed_while_braked
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.interface import Instant
from deltaq_controllers.modes.limitation import Conditioning, Limit, Limitation
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved import DrivenTasks, ResolvedMode
from deltaq_protocol.arrays import Array


class SelfMotionMode(ResolvedMode):
    """Moves within the null space of the hands (Hooper & Noakes, section II).

    The tasks are the hands, held where they were when the mode began, and the joints that are driven. A brake of the
    gate, which is straight in joint space, may move the hands a little, and the next motion corrects that. A joint that
    cannot move without the hands does not move.

    Raises:
        ControllerError: the robot is not redundant.
    """

    name = ModeName.SELF_MOTION
    drives_hands = False

    def __init__(self, robot: RobotModel) -> None:
        hands = len(robot.hands)
        if robot.n <= 6 * hands:
            raise ControllerError(
                f"self-motion needs more than {6 * hands} joints for {hands} hand{'s' * (hands > 1)}, robot "
                f"{robot.name!r} has {robot.n}; choose joint, decoupled or coupled"
            )
        super().__init__(robot)
        self.drives_joints = np.ones(robot.n, dtype=np.bool_)
        self._joints = np.eye(robot.n)
        self._driven = np.zeros(robot.n, dtype=np.bool_)

    def enter(self, q: Array) -> None:
        """Keep the hands at their present poses."""
        super().enter(q)
        self._hands.update(q)
        self._line.begin(self._hands)

    def _rest(self) -> None:
        """The hands stay where they were when the mode began."""

    def _intervened(self) -> None:
        """The hands stay where they were when the mode began, whatever the gate did."""

    def _allowed(self, instant: Instant, motion: Motion) -> float:
        rates = instant.dq_last / instant.cycle_s
        going = float(np.abs(rates[motion.joints != 0.0]).max(initial=0.0))
        allowed = going * allowed_while_braked(
            self._hands, instant.q_cmd, rates, self._robot.max_acceleration
        )
        asked = float(np.abs(motion.joints).max())
        return min(1.0, allowed / asked) if going > 0.0 and asked > 0.0 else 1.0

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        del held  # it stays as the hands do
        driven = motion.joints != 0.0
        if (driven != self._driven).any():
            # other tasks than before: how they go is read off the joints
            self._driven, self._going = driven, None
        hands = self._units[:, None] * self._hands.jacobian
        rates = np.concatenate([np.zeros(len(hands)), motion.joints[driven]])
        return DrivenTasks(np.vstack([hands, self._joints[driven]]), rates)

    def _way(self, rates: Array) -> Array:
        rates[: len(self._units)] = 0.0
        return rates

    def _ended(self, motion: Motion, conditioning: Conditioning) -> Limitation:
        del conditioning
        names = ", ".join(np.array(self._robot.joint_names)[motion.joints != 0.0])
        return Limitation(Limit.SINGULARITY, names, f"{names} cannot move here without moving the hand")
