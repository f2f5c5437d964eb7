"""Decoupled Cartesian mode: base joints one by one, the six joints next to each hand by the hand's motion."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved import DrivenTasks, ResolvedMode


class DecoupledMode(ResolvedMode):
    """The classic mode of teleoperation (Hooper & Noakes, section II).

    The tasks are the hands, carried along by the base joints, and the base joints. An object that the hands hold is
    carried along by base joints that carry all of them; under the others it stays where it is.
    """

    name = ModeName.DECOUPLED
    drives_hands = True

    def __init__(self, robot: RobotModel) -> None:
        super().__init__(robot)
        self.drives_joints = np.logical_not(self._hands.arms.any(axis=0))
        self._base = np.eye(robot.n)[self.drives_joints]

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        hands = self._units[:, None] * self._hands.jacobian
        base = np.where(self.drives_joints, motion.joints, 0.0)
        carrying = base if held is None else np.where(self._hands.moved_by.all(axis=0), base, 0.0)
        rates = self._units * motion.hands.ravel() + hands @ carrying
        return DrivenTasks(np.vstack([hands, self._base]), np.concatenate([rates, base[self.drives_joints]]))
