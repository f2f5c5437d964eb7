"""Coupled Cartesian mode: hand motion in, all joints out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.criteria.normalised import Normalised
from deltaq_controllers.criteria.postures import Postures, RobotData
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.joint_travel import travel_gradient
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved import DrivenTasks, ResolvedMode
from deltaq_protocol.arrays import Array

DRIFT_SHARE_S_M = 2.5
"""Fraction of its greatest speed that the criteria may ask of a joint, per m/s of the fastest hand [s/m]."""

FULL_DESCENT_S = 0.005
"""Weighted descent of the criteria, over a joint's greatest speed, above which it is clipped [s]."""


@dataclass(frozen=True)
class WeightedCriterion:
    """A cost that the redundant joints reduce.

    Attributes:
        gradient: (n,) gradient at a configuration (n,).
        weight: its weight among the criteria.
    """

    gradient: Callable[[Array], Array]
    weight: float = 1.0


def weighed(data: RobotData, weights: Mapping[str, float]) -> WeightedCriterion:
    """A weighted sum of the criteria of `deltaq_controllers.criteria.table`, by name.

    Raises:
        CriterionError: an unknown criterion, or a weight that is negative or not finite.
    """
    cost = Normalised(data, weights)

    def gradient(q: Array) -> Array:
        row: Array = cost.gradient(Postures(data, q[None]))[0]
        return row

    return WeightedCriterion(gradient)


class CoupledMode(ResolvedMode):
    """Shared control (Hooper & Noakes, section IV): redundancy resolved by weighted criteria.

    The tasks are the hands. The joints drift down the criteria in their null space (Liegeois), only while the operator
    moves a hand: no input, no motion.

    Args:
        robot: the robot.
        criteria: what redundant joints do; by default they stay near the middle of their ranges.
    """

    name = ModeName.COUPLED
    drives_hands = True

    def __init__(self, robot: RobotModel, criteria: Sequence[WeightedCriterion] | None = None) -> None:
        super().__init__(robot)
        self._max_velocity = robot.max_velocity
        self.drives_joints = np.zeros(robot.n, dtype=np.bool_)
        self._criteria = (
            (WeightedCriterion(lambda q: travel_gradient(q, robot.lower, robot.upper)),)
            if criteria is None
            else tuple(criteria)
        )

    def _tasks(self, motion: Motion, held: HeldObject | None) -> DrivenTasks:
        del held
        return DrivenTasks(self._units[:, None] * self._hands.jacobian, self._units * motion.hands.ravel())

    def _drift(self, q: Array, made: Array) -> Array:
        """(n,) rates that lower the criteria."""
        descent = np.zeros_like(q)
        for criterion in self._criteria:
            descent -= criterion.weight * criterion.gradient(q)
        return _shared_out(descent, self._shares, self._max_velocity, made)


@compiled
def _shared_out(descent: Array, shares: Array, max_velocity: Array, made: Array) -> Array:
    """(n,) joint rates of a descent, in proportion to the speed of the fastest hand; they go at `made` (r,)."""
    # shared out as the tasks are: only then does what the tasks leave of the descent still descend
    rates = shares * descent
    fastest, square = FULL_DESCENT_S, 0.0
    for joint in range(len(rates)):
        fastest = max(fastest, abs(rates[joint]) / max_velocity[joint])
    for first in range(0, len(made), 3):
        square = max(square, made[first] ** 2 + made[first + 1] ** 2 + made[first + 2] ** 2)
    return rates * (DRIFT_SHARE_S_M * math.sqrt(square) / fastest)
