"""The advisor's objective: a weighted sum of criteria over the free joints, with the hands in place.

Hooper and Noakes, III-B and III-C: constraint tracking leaves the base joints free (5 of 17 on a DAWM), and a trial
that exceeds a limit, cannot reach or collides is rejected at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.criteria import TABLE, Normalised, Postures, RobotData
from deltaq_controllers.criteria.table import references
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array, Indices
from deltaq_protocol.errors import DeltaqError

WEIGHTS = {"travel": 1.0, "obstacle_clearance": 1.0, "robot_clearance": 1.0, "self_clearance": 1.0}
"""The two criteria of the paper's application: joint limits and collisions, the latter split by kind of body."""

ROBOTS = "robot_clearance"
"""Left out of `WEIGHTS` where there is no other robot."""


class AdvisorError(DeltaqError):
    """A task that the advisor cannot work on."""


class NotRedundantError(AdvisorError):
    """A non-redundant robot with its hand in place: there is nothing to advise on."""


@dataclass(frozen=True)
class Trials:
    """Feasible configurations among those tried.

    Attributes:
        q: (M, n) configurations.
        energy: (M,) their energies.
        row: (M,) which of the trials each belongs to; one trial may have several branches, or none.
    """

    q: Array
    energy: Array
    row: Indices


class AdvisorProblem:
    """One task of one robot.

    Args:
        cell: model of the cell.
        robot: name of the robot.
        T_world_hands: (h, 4, 4) where its hands should be.
        weights: of the criteria; by default those of the tracker's task, and `WEIGHTS` if it has none.
        tracker: of the robot and its task, where there is one already.
        others: (n,) configuration of each other robot; at home if not given.
        hands_may_leave: whether hands that stay in place may leave their poses on the path, and come back.

    Attributes:
        tracker, hands_may_leave: as given.
        robot: the tracker's, with a joint for each tolerance of the task; configurations contain these.
        task: the tracker's.
        data: of the robot, for the criteria.
        weights: of the criteria, as given or `WEIGHTS`.
        energy: the weighted sum.
        limits: (2, n) lower and upper limits of the joints within which configurations are tried.
        count: trials so far.

    Raises:
        AdvisorError: the robot is unknown, has no free joint, or the poses are not valid.
        TrackingError: its arms have no inverse.
        CriterionError: an unknown criterion.
    """

    def __init__(
        self,
        cell: CellModel,
        robot: str,
        T_world_hands: Array,
        weights: Mapping[str, float] | None = None,
        tracker: ConstraintTracker | None = None,
        others: Mapping[str, Array] | None = None,
        hands_may_leave: bool = False,
    ) -> None:
        if robot not in cell.robots:
            raise AdvisorError(f"the cell has no robot {robot!r}; it has {', '.join(cell.robots)}")
        self.cell = cell
        self.tracker = tracker or ConstraintTracker(cell.robots[robot])
        self.robot, self.task = self.tracker.robot, self.tracker.task
        standing = {name: model.home for name, model in cell.robots.items()} | dict(others or {})
        own = self.tracker.kinematics if self.robot.n == self.tracker.driven else None
        self.data = RobotData(cell, robot, kinematics=own, others=standing, task=self.task)
        self.hands_may_leave = hands_may_leave
        self._check_redundant()
        self.poses = _checked(T_world_hands, len(self.robot.hands))
        if (weights := weights or self.task.weights) is None:
            weights = {
                name: weight for name, weight in WEIGHTS.items() if name != ROBOTS or len(cell.robots) > 1
            }
        self.weights = dict(weights)
        self.energy = Normalised(self.data, self.weights)
        self.limits: Array = np.stack([self.robot.lower, self.robot.upper])
        self.count = 0

    def at(
        self, T_world_hands: Array, others: Mapping[str, Array] | None = None, hands_may_leave: bool = False
    ) -> AdvisorProblem:
        """This task with other poses of the hands (h, 4, 4) and of other robots (n,), and no trials yet.

        Raises:
            AdvisorError: the poses are not valid, or the robot has no free joint and its hand may not leave.
        """
        self.data.bodies.place(others or {})
        other = copy(self)
        other.poses, other.count = _checked(T_world_hands, len(self.robot.hands)), 0
        other.hands_may_leave = hands_may_leave
        other._check_redundant()
        return other

    def _check_redundant(self) -> None:
        if not self.free and not self.hands_may_leave:
            raise NotRedundantError(
                f"robot '{self.robot.name}' is not redundant: with its hand in place there is nothing to advise on, "
                "unless the hand may leave and come back"
            )

    def weighed(self, weights: Mapping[str, float]) -> AdvisorProblem:
        """This task with other criteria.

        Raises:
            CriterionError: an unknown criterion, or a weight that is negative or not finite.
        """
        other = copy(self)
        other.energy = Normalised(self.data, weights, self.references)
        return other

    def inside(self, margin: Array) -> AdvisorProblem:
        """This task with a margin (n,) to the limits of the joints [rad or m]."""
        other = copy(self)
        other.limits = self.limits + np.stack([margin, -margin])
        return other

    @property
    def lower(self) -> Array:
        """(m,) lower limits of the free joints."""
        lower: Array = self.limits[0, self.tracker.base]
        return lower

    @property
    def upper(self) -> Array:
        """(m,) their upper limits."""
        upper: Array = self.limits[1, self.tracker.base]
        return upper

    @property
    def free(self) -> int:
        """Number m of free joints."""
        return len(self.tracker.base)

    @cached_property
    def references(self) -> dict[str, float]:
        """The value of every criterion that costs one half."""
        values = references(self.data, TABLE).tolist()
        return {criterion.name: value for criterion, value in zip(TABLE, values, strict=True)}

    def try_all(self, base: Array) -> Trials:
        """Every feasible branch of every trial.

        Args:
            base: (N, m) values of the free joints.
        """
        self.count += len(base)
        within = np.flatnonzero(((base >= self.lower) & (base <= self.upper)).all(axis=1))
        arms = []
        for arm, branches in zip(
            self.tracker.arms, self.tracker.solve(base[within], self.poses), strict=True
        ):
            lower, upper = self.limits[:, arm.joints]
            arms.append((arm.joints, *branches.fitted(0.5 * (lower + upper), lower, upper)))
        found_q, found_row = [], []
        for combination in product(*(range(inside.shape[1]) for _, _, inside in arms)):
            rows = np.flatnonzero(
                np.logical_and.reduce(
                    [inside[:, b] for (_, _, inside), b in zip(arms, combination, strict=True)]
                )
            )
            if len(rows):
                q = np.empty((len(rows), self.robot.n))
                q[:, self.tracker.base] = base[within[rows]]
                for (joints, solutions, _), branch in zip(arms, combination, strict=True):
                    q[:, joints] = solutions[rows, branch]
                found_q.append(q)
                found_row.append(within[rows])
        if not found_q:
            return Trials(np.empty((0, self.robot.n)), np.empty(0), np.empty(0, dtype=np.intp))
        q, row = np.concatenate(found_q), np.concatenate(found_row)
        energy = self.energies(q)
        kept = np.isfinite(energy)
        return Trials(q[kept], energy[kept], row[kept])

    def try_best(self, base: Array) -> tuple[Array, Array]:
        """(N, n) best branch of every trial, NaN where none is feasible, and (N,) energies, infinite there."""
        trials = self.try_all(base)
        q, energy = np.full((len(base), self.robot.n), np.nan), np.full(len(base), np.inf)
        worst_first = np.argsort(-trials.energy, kind="stable")
        q[trials.row[worst_first]] = trials.q[worst_first]
        energy[trials.row[worst_first]] = trials.energy[worst_first]
        return q, energy

    def follow(self, base: Array, reference: Array) -> tuple[Array, Array]:
        """Like `try_best`, but each on the branch nearest to a reference (n,) or (N, n)."""
        self.count += len(base)
        q = self.tracker.track(base, self.poses, reference)
        energy = np.full(len(base), np.inf)
        there = ((q >= self.limits[0]) & (q <= self.limits[1])).all(axis=1)
        if there.any():
            energy[there] = self.energies(q[there])
        return q, energy

    def energies(self, q: Array) -> Array:
        """(N,) energies of configurations (N, n); infinite in collision."""
        postures = Postures(self.data, q)
        energy: Array = self.energy.total(postures)
        energy[postures.near.row[postures.near.room <= 0.0]] = np.inf
        return energy

    def jacobians(self, q: Array) -> Array:
        """(N, h, 6, n) of the hands' places at configurations (N, n), linear over angular, world axes."""
        return self.tracker.kinematics.hand_jacobians(self.tracker.kinematics.frames(q))


def _checked(poses: Array, hands: int) -> Array:
    poses = np.asarray(poses, dtype=np.float64)
    if poses.shape != (hands, 4, 4) or not np.isfinite(poses).all():
        raise AdvisorError(f"the hands' poses must be finite and of shape ({hands}, 4, 4), got {poses.shape}")
    turned = np.einsum("hij,hkj->hik", poses[:, :3, :3], poses[:, :3, :3])
    if np.abs(turned - np.eye(3)).max() > 1e-6 or np.any(np.linalg.det(poses[:, :3, :3]) < 0.0):
        raise AdvisorError("the hands' poses must have proper rotation matrices")
    return poses
