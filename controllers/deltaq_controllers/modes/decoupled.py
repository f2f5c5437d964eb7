"""Decoupled Cartesian mode: base joints one by one, the six joints next to each hand by the hand's motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved import DrivenTasks, ResolvedMode
from deltaq_protocol.arrays import Array, Indices


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
        self._driven = np.flatnonzero(self.drives_joints)
        self._carries_all = self.drives_joints & self._hands.moved_by.all(axis=0)

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        carries = self.drives_joints if held is None else self._carries_all
        rows, rates = _carried(
            self._units, self._hands.jacobian, motion.hands, motion.joints, self._driven, carries
        )
        return DrivenTasks(rows, rates)


@compiled
def _carried(
    units: Array, jacobian: Array, twists: Array, joints: Array, driven: Indices, carries: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Rows and rates of the hands' twists (h, 6), which the joints that carry add to, and of the driven joints (m,)."""
    tasks, n = jacobian.shape
    rows, rates = np.zeros((tasks + len(driven), n)), np.empty(tasks + len(driven))
    for row in range(tasks):
        rates[row] = units[row] * twists[row // 6, row % 6]
        for joint in range(n):
            rows[row, joint] = units[row] * jacobian[row, joint]
            if carries[joint]:
                rates[row] += rows[row, joint] * joints[joint]
    for place in range(len(driven)):
        rows[tasks + place, driven[place]] = 1.0
        rates[tasks + place] = joints[driven[place]]
    return rows, rates
