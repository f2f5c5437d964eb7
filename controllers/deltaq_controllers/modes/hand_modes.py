"""The modes whose tasks are the hands: decoupled, self-motion and coupled."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.criteria.postures import Postures, RobotData
from deltaq_controllers.criteria.table import Normalised
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.hands import HeldObject, allowed_while_braked
from deltaq_controllers.modes.interface import Conditioning, Instant, Limit, Limitation, Motion
from deltaq_controllers.modes.resolved import DrivenTasks, ResolvedMode
from deltaq_protocol.arrays import Array, Indices
from deltaq_protocol.driving import DrivingMode

# Coupled Cartesian mode: hand motion in, all joints out.


# Joint travel: how far the joints are from the middle of their ranges (Hooper & Noakes, Table 2, constraint).


def travel(q: Array, lower: Array, upper: Array) -> float:
    """0 with all joints in the middle of their ranges, 1 at the ends: `sum(((q - middle) / half)^2) / n`."""
    return float(np.mean(((2.0 * q - lower - upper) / (upper - lower)) ** 2))


@compiled
def travel_gradient(q: Array, lower: Array, upper: Array) -> Array:
    """(n,) gradient of `travel` [1/rad or 1/m]."""
    gradient = np.empty_like(q)
    for joint in range(len(q)):
        width = upper[joint] - lower[joint]
        gradient[joint] = 4.0 * (2.0 * q[joint] - lower[joint] - upper[joint]) / width**2 / len(q)
    return gradient


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
        criteria: for redundant joints; by default they stay near the middle of their ranges.
    """

    name = DrivingMode.COUPLED
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


# Decoupled Cartesian mode: base joints one by one, the six joints next to each hand by the hand's motion.


class DecoupledMode(ResolvedMode):
    """The classic mode of teleoperation (Hooper & Noakes, section II).

    The tasks are the hands, carried along by the base joints, and the base joints. An object that the hands hold is
    carried along by base joints that carry all of them; under the others it stays where it is.
    """

    name = DrivingMode.DECOUPLED
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


# Self-motion mode: any joint driven, all others move so that the hands stay.


class SelfMotionMode(ResolvedMode):
    """Moves within the null space of the hands (Hooper & Noakes, section II).

    The tasks are the hands, held where they were when the mode began, and the joints that are driven. A brake of the
    gate, which is straight in joint space, may move the hands a little, and the next motion corrects that. A joint that
    cannot move without the hands does not move.

    Raises:
        ControllerError: the robot is not redundant.
    """

    name = DrivingMode.SELF_MOTION
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
        """The hands keep their poses from the start of the mode, also after scaled increments."""

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
