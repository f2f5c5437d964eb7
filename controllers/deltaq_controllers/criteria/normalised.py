"""Costs that can be weighed against one another: every criterion on a scale from 0, good, to 1, bad."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from deltaq_controllers.criteria.postures import Postures, RobotData
from deltaq_controllers.criteria.table import BY_NAME, Criterion
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

SAMPLES = 50
"""Configurations over which the median is taken."""
_LEAST_REFERENCE = 1e-12


class CriterionError(DeltaqError):
    """An unknown criterion, or an invalid weight."""


def check_known(name: str) -> None:
    """Check that there is a criterion of this name.

    Raises:
        CriterionError: there is none.
    """
    if name not in BY_NAME:
        raise CriterionError(f"no criterion {name!r}; there are {', '.join(BY_NAME)}")


class Normalised:
    """A weighted sum of criteria, each brought to a cost first.

    With x the value and x0 the reference, the cost is `x / (x + x0)` where less is better and `x0 / (x + x0)` where
    more is: one half at the reference, the same for every robot. A clearance below zero costs more than 1,
    growing linearly.

    Args:
        data: of the robot.
        weights: criterion to weight, not negative.
        known: references by criterion, if they are known already.

    Attributes:
        criteria: those with a weight, in the order of the weights.
        weights: (k,) their weights.
        references: (k,) their references.

    Raises:
        CriterionError: an unknown criterion, or a weight that is negative or not finite.
    """

    def __init__(
        self, data: RobotData, weights: Mapping[str, float], known: Mapping[str, float] | None = None
    ) -> None:
        for name, weight in weights.items():
            check_known(name)
            if not np.isfinite(weight) or weight < 0.0:
                raise CriterionError(f"the weight of {name} must be a finite number, 0 or more, got {weight}")
        self.criteria = tuple(BY_NAME[name] for name, weight in weights.items() if weight > 0.0)
        self.weights = np.array([weight for weight in weights.values() if weight > 0.0])
        self.references = (
            references(data, self.criteria)
            if known is None
            else np.array([known[criterion.name] for criterion in self.criteria])
        )

    def costs(self, postures: Postures) -> Array:
        """(N, k) cost by criterion."""
        columns = [
            cost(criterion, scale, criterion.value(postures))
            for criterion, scale in zip(self.criteria, self.references, strict=True)
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((len(postures), 0))

    def total(self, postures: Postures) -> Array:
        """(N,) weighted sum of the costs."""
        total: Array = self.costs(postures) @ self.weights
        return total

    def gradient(self, postures: Postures) -> Array:
        """(N, n) derivative of the weighted sum by the joints."""
        gradient = np.zeros_like(postures.q)
        for criterion, weight, scale in zip(self.criteria, self.weights, self.references, strict=True):
            slope = _slope(criterion, scale, criterion.value(postures))
            gradient += weight * slope[:, None] * criterion.gradient(postures)
        return gradient


def references(data: RobotData, criteria: Sequence[Criterion]) -> Array:
    """(k,) the values that cost one half: the criterion's own, or its median over the robot's workspace.

    Of a criterion that is zero nearly everywhere, such as a load where a URDF has no masses, a very small one.
    """
    robot = data.robot
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (SAMPLES, robot.n))
    postures = Postures(data, q)
    return np.array(
        [
            max(float(np.median(criterion.value(postures))), _LEAST_REFERENCE)
            if criterion.reference is None
            else criterion.reference
            for criterion in criteria
        ]
    )


def cost(criterion: Criterion, scale: float, value: Array) -> Array:
    """(N,) cost of values (N,)."""
    beyond = np.maximum(value, 0.0)
    if criterion.better == "less":
        result: Array = beyond / (beyond + scale)
    else:
        result = scale / (beyond + scale) - np.minimum(value, 0.0) / scale
    return result


def _slope(criterion: Criterion, scale: float, value: Array) -> Array:
    beyond = np.maximum(value, 0.0)
    slope: Array = scale / np.square(beyond + scale)
    return slope if criterion.better == "less" else -slope
