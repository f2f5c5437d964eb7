"""The performance criteria of Hooper and Noakes, Table 2, as one table; each category has at least two.

The paper names the categories; the formulas are from the sources named in each row. Where a robot has several hands, a
criterion of a hand is that of its worst hand: a mean would hide one that is singular. Room is distance beyond the stop
distance, by the gate's shapes; pairs whose distance the hands' poses fix are left out. Speeds are the joints' limits,
`D = diag(max_velocity)`; lengths are weighed against angles at 1 m to 1 rad. `t_j` is the torque that gives joint j its
acceleration: a cell's description has no torque limits.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from deltaq_controllers.criteria import formulas
from deltaq_controllers.criteria.formulas import Postures, RobotData
from deltaq_controllers.criteria.near_bodies import PairKind
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError


class Category(StrEnum):
    """The categories of Table 2, and two that the introduction lists."""

    CONSTRAINT = "constraint"
    GEOMETRIC = "geometric"
    INERTIAL = "inertial"
    COMPLIANCE = "compliance"
    KINETIC_ENERGY = "kinetic energy"
    DUAL_ARM = "dual arm"
    TASK = "task"


@dataclass(frozen=True)
class Criterion:
    """One row of the table.

    Attributes:
        name: of the criterion.
        category: of Table 2.
        formula: the definition.
        source: the publication.
        unit: of its value.
        better: whether less or more of it is better.
        value: (N,) values of N configurations.
        gradient: (N, n) their derivatives by the joints; None where differences are quick enough.
        reference: value at which the cost is one half; None takes the median over the robot's workspace.
    """

    name: str
    category: Category
    formula: str
    source: str
    unit: str
    better: Literal["less", "more"]
    value: Callable[[Postures], Array]
    gradient: Callable[[Postures], Array] | None = None
    reference: float | None = None


TABLE: tuple[Criterion, ...] = (
    Criterion(
        "travel", Category.CONSTRAINT,
        "mean over the joints of ((q - middle) / half range)^2",
        "Liegeois 1977; joint travel availability of Hooper and Noakes, III-A", "1", "less",
        formulas.travel, formulas.travel_gradient,
    ),
    Criterion(
        "limits", Category.CONSTRAINT,
        "mean over the joints of range^2 / (4 (upper - q) (q - lower))",
        "Chan and Dubey 1995", "1", "less",
        formulas.limits,
    ),
    Criterion(
        "speed", Category.CONSTRAINT,
        "least singular value of J_v D: the hand's speed in its slowest direction at full joint speed",
        "Van Doren and Tesar, speed availability", "m/s", "more",
        formulas.speed,
    ),
    Criterion(
        "acceleration", Category.CONSTRAINT,
        "least singular value of J_v A, A the joints' accelerations: the hand's in its slowest direction",
        "Van Doren and Tesar, acceleration availability", "m/s^2", "more",
        formulas.acceleration,
    ),
    Criterion(
        "torque", Category.CONSTRAINT,
        "mean over the joints of (gravity's torque / t_j)^2",
        "Van Doren and Tesar, torque availability", "1", "less",
        formulas.torque,
    ),
    Criterion(
        "clearance", Category.CONSTRAINT,
        "smooth minimum of the room of the nearest pairs of all pairs",
        "approach to collisions of Hooper and Noakes, III-C", "m", "more",
        *formulas.clearances(*PairKind), reference=0.1,
    ),
    Criterion(
        "obstacle_clearance", Category.CONSTRAINT,
        "smooth minimum of the room of the nearest pairs of the robot and the structure",
        "Hooper and Noakes, I: obstacle avoidance, environment", "m", "more",
        *formulas.clearances(PairKind.ENVIRONMENT), reference=0.1,
    ),
    Criterion(
        "robot_clearance", Category.CONSTRAINT,
        "smooth minimum of the room of the nearest pairs of the robot and other robots as they stand",
        "Hooper and Noakes, I: obstacle avoidance, environment", "m", "more",
        *formulas.clearances(PairKind.ROBOTS), reference=0.1,
    ),
    Criterion(
        "self_clearance", Category.CONSTRAINT,
        "smooth minimum of the room of the nearest pairs of two bodies of the robot",
        "Hooper and Noakes, I: obstacle avoidance, system", "m", "more",
        *formulas.clearances(PairKind.SELF), reference=0.1,
    ),
    Criterion(
        "manipulability", Category.GEOMETRIC,
        "sqrt(det(J J^T))",
        "Yoshikawa 1985", "m^3", "more",
        formulas.manipulability,
    ),
    Criterion(
        "condition", Category.GEOMETRIC,
        "least over greatest singular value of J",
        "Salisbury and Craig 1982", "1", "more",
        formulas.condition,
    ),
    Criterion(
        "smallest_singular_value", Category.GEOMETRIC,
        "least singular value of J",
        "Klein and Blaho 1987", "m", "more",
        formulas.smallest,
    ),
    Criterion(
        "effective_mass", Category.INERTIAL,
        "3 / tr(J_v M^-1 J_v^T): harmonic mean of the mass felt at the hand over all directions",
        "Khatib 1995", "kg", "less",
        formulas.effective_mass,
    ),
    Criterion(
        "effective_mass_rate", Category.INERTIAL,
        "norm of D d(effective_mass)/dq: how fast it can change",
        "Van Doren and Tesar, rate of change of inertial criteria", "kg/s", "less",
        formulas.effective_mass_rate,
    ),
    Criterion(
        "compliance", Category.COMPLIANCE,
        "tr(J_v K^-1 J_v^T) / 3: deflection of the hand per force, mean over all directions",
        "Van Doren and Tesar, potential energy; Salisbury 1980", "m/N", "less",
        formulas.compliance,
    ),
    Criterion(
        "potential_energy_partition", Category.COMPLIANCE,
        "sum of p_j^2 with p_j = s_j / sum s, s_j = |column j of J_v|^2 / k_j: 1/n even, 1 all in one joint",
        "Van Doren and Tesar, potential energy partition values", "1", "less",
        formulas.potential_partition,
    ),
    Criterion(
        "kinetic_energy", Category.KINETIC_ENERGY,
        "tr(D M D) / 2: energy at full joint speed, mean over the joints' directions",
        "Van Doren and Tesar, kinetic energy content", "J", "less",
        formulas.kinetic_energy,
    ),
    Criterion(
        "kinetic_energy_partition", Category.KINETIC_ENERGY,
        "sum of p_j^2 with p_j = s_j / sum s, s_j = M_jj D_j^2 / 2: 1/n even, 1 all in one joint",
        "Van Doren and Tesar, kinetic energy partition values", "1", "less",
        formulas.kinetic_partition,
    ),
    Criterion(
        "relative_load", Category.DUAL_ARM,
        "greatest fraction of one arm in the sum of (gravity's torque / t_j)^2 over the arms",
        "Hooper and Noakes, I: relative load", "1", "less",
        formulas.relative_load,
    ),
    Criterion(
        "relative_energy", Category.DUAL_ARM,
        "greatest fraction of one arm in the sum of M_jj D_j^2 / 2 over the arms",
        "Hooper and Noakes, I: energy", "1", "less",
        formulas.relative_energy,
    ),
    Criterion(
        "relative_compliance", Category.DUAL_ARM,
        "tr(J_r K^-1 J_r^T) / 3, J_r = J_v of one hand less that of the other: their deflection against each other",
        "Hooper and Noakes, I: compliance", "m/N", "less",
        formulas.relative_compliance,
    ),
    Criterion(
        "force", Category.TASK,
        "1 / greatest singular value of J_v diag(1 / t_j): force in the weakest direction",
        "Hooper and Noakes, I: force; Chiu 1988", "N", "more",
        formulas.force,
    ),
    Criterion(
        "deformation", Category.TASK,
        "greatest singular value of J_v K^-1 J_v^T: deflection per force in the softest direction",
        "Hooper and Noakes, I: deformation", "m/N", "less",
        formulas.deformation,
    ),
    Criterion(
        "dexterity", Category.TASK,
        "least over greatest singular value of J_v",
        "Hooper and Noakes, I: dexterity; Salisbury and Craig 1982", "1", "more",
        formulas.dexterity,
    ),
)  # fmt: skip
"""All criteria."""

BY_NAME = {criterion.name: criterion for criterion in TABLE}


# Costs that can be weighed against one another: every criterion on a scale from 0, good, to 1, bad.


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
        gradient, others = np.zeros_like(postures.q), []
        for criterion, weight, scale in zip(self.criteria, self.weights, self.references, strict=True):
            if criterion.gradient is None:
                others.append((criterion, weight, scale))
                continue
            slope = _slope(criterion, scale, criterion.value(postures))
            gradient += weight * slope[:, None] * criterion.gradient(postures)
        if others:
            gradient += formulas.slopes(
                lambda at: sum(weight * cost(one, scale, one.value(at)) for one, weight, scale in others),
                postures,
            )
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
