"""Coupled Cartesian mode: hand motion in, all joints out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.criteria.normalised import Normalised
from deltaq_controllers.criteria.postures import Postures, RobotData
from deltaq_controllers.modes.avoidance import limit_weights, moves_out, travel_gradient
from deltaq_controllers.modes.hands import Hands, turned
from deltaq_controllers.modes.interface import TeleoperationMode
from deltaq_controllers.modes.limitation import Limitation, of_conditioning
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.modes.resolved_rate import LENGTH_M, Inverse
from deltaq_controllers.modes.singularity_slowdown import slowed
from deltaq_protocol.arrays import Array

DRIFT_SHARE_S_M = 2.0
"""Fraction of its greatest speed that the criteria may ask of a joint, per m/s of the fastest hand [s/m]."""

FULL_DESCENT_S = 0.02
"""Weighted descent of the criteria, over a joint's greatest speed, above which it is clipped [s]."""

REVOLUTE_SHARE = 0.25
"""Weight of a rad/s of a revolute joint relative to a m/s of a prismatic one, in W^-1."""

_NO_WORSE_M = 1e-6
"""Joints are kept off their limits if that leaves the hands no farther off than this [m]."""


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


class CoupledMode(TeleoperationMode):
    """Shared control (Hooper & Noakes, section IV): redundancy resolved by weighted criteria.

    Joint rates are `g + W^-1 J^T (J W^-1 J^T)^-1 (v - J g)` (Whitney; Liegeois), g = -W^-1 grad the descent of
    the criteria, W the weights that keep joints off their limits. After it Newton's method keeps the hands on
    their lines. The criteria act only while the operator moves a hand: no input, no motion.

    Args:
        robot: the robot.
        criteria: what redundant joints do; by default they stay near the middle of their ranges.
    """

    name = ModeName.COUPLED
    drives_hands = True

    def __init__(self, robot: RobotModel, criteria: Sequence[WeightedCriterion] | None = None) -> None:
        self._hands = Hands(robot)
        self._lower, self._upper = robot.lower, robot.upper
        self._max_velocity = robot.max_velocity
        self._share = np.where(robot.revolute, REVOLUTE_SHARE, 1.0)
        self.drives_joints = np.zeros(robot.n, dtype=np.bool_)
        self._criteria = (
            (WeightedCriterion(lambda q: travel_gradient(q, self._lower, self._upper)),)
            if criteria is None
            else tuple(criteria)
        )
        self._descent_at: Array = np.empty(0)
        self._descent: Array = np.zeros(robot.n)

    def bounded(self, q: Array, motion: Motion) -> Motion:
        """The motion, slowed towards singularities and the edge of the robot's reach."""
        return slowed(self._hands, self._inverse_at, q, motion)

    def _inverse_at(self, q: Array) -> Inverse:
        self._hands.update(q)
        return Inverse.of(self._hands.jacobian, self._weights(q))

    def step(self, q: Array, motion: Motion, time_s: float) -> Array:
        """The displacement of all joints."""
        if not motion.hands.any():
            return np.zeros_like(q)
        hands = self._hands
        hands.update(q)
        wanted = motion.hands * time_s
        goal = turned(hands.rotations, wanted[:, 3:]), hands.positions + wanted[:, :3]
        drift = time_s * self._drift(q, motion)
        weights = self._weights(q)
        displacement, off_m = self._solved(q, wanted.ravel(), goal, drift, weights)
        out = moves_out(q, displacement, self._lower, self._upper)
        if out.any():
            kept_in = np.where(out, 0.0, drift), np.where(out, 0.0, weights)
            other, other_off_m = self._solved(q, wanted.ravel(), goal, *kept_in)
            if other_off_m <= off_m + _NO_WORSE_M:
                return other
        return displacement

    def _solved(
        self, q: Array, wanted: Array, goal: tuple[Array, Array], drift: Array, weights: Array
    ) -> tuple[Array, float]:
        """The displacement that brings the hands to a goal, and how far off it leaves them [m]."""
        hands = self._hands
        hands.update(q)
        inverse = Inverse.of(hands.jacobian, weights)
        displacement = drift + inverse(wanted - hands.jacobian @ drift)
        hands.update(q + displacement)
        displacement += inverse(hands.error(*goal))
        hands.update(q + displacement)
        return displacement, float(np.linalg.norm(hands.error(*goal)))

    def limitation(self, q: Array, motion: Motion) -> Limitation | None:
        """A singularity of the whole robot or the edge of its reach."""
        return of_conditioning(self._hands, self._inverse_at(q), motion.hands.ravel(), q)

    def _weights(self, q: Array) -> Array:
        return self._share * limit_weights(q, self._lower, self._upper)

    def _drift(self, q: Array, motion: Motion) -> Array:
        """(n,) rates that lower the criteria."""
        if not np.array_equal(q, self._descent_at):
            # a cycle asks for several motions from one configuration, and a gradient may cost a millisecond
            self._descent_at = q
            self._descent = np.zeros_like(q)
            for criterion in self._criteria:
                self._descent -= criterion.weight * criterion.gradient(q)
        # weighted as the projection is: only then does the projection of the descent still descend
        rates = self._weights(q) * self._descent
        fastest = float(np.max(np.abs(rates) / self._max_velocity))
        travel, turn = np.linalg.norm(motion.hands.reshape(-1, 2, 3), axis=2).max(axis=0)
        allowed = DRIFT_SHARE_S_M * max(float(travel), LENGTH_M * float(turn))
        drift: Array = rates * allowed / max(fastest, FULL_DESCENT_S)
        return drift
