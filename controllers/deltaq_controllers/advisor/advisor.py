"""The advisor: a global method, local polish, de-duplication, exact clearance, and a way to get there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.advisor.descent import descend
from deltaq_controllers.advisor.exact import Clearance, ExactClearance
from deltaq_controllers.advisor.methods import METHODS
from deltaq_controllers.advisor.problem import AdvisorError, Problem
from deltaq_controllers.advisor.self_motion import SelfMotion
from deltaq_controllers.criteria import TABLE, Postures
from deltaq_controllers.criteria.normalised import cost

Array = NDArray[np.float64]

DISTINCT = 0.25
"""Options differ by more than this in at least one joint [rad or m]."""

POLISHED, POLISH_STEPS = 32, 15
"""How many configurations are polished, and how far."""

POOL = 400
"""Configurations that are remembered while searching."""

THERE_M, THERE_RAD = 1e-4, 1e-3
"""The robot's hands count as being where they shall be within this."""


@dataclass(frozen=True)
class Progress:
    """How far the advisor is.

    Attributes:
        doing: `searching`, `polishing`, `checking` or `finding paths`.
        done: share of that step that is done.
        energy: least so far; infinite before the first.
        trials: so far.
    """

    doing: str
    done: float
    energy: float
    trials: int


@dataclass(frozen=True)
class Option:
    """One way to hold the hands where they shall be.

    Attributes:
        q: (n,) configuration.
        energy: the weighted sum, by which options are ranked.
        values: value of every criterion, in its unit.
        costs: its cost, 0 good to 1 bad.
        clearance: exact, with the tightest pair.
        nearest_limit: the joint that is nearest to a limit of its own.
        limit_share: its distance from there as a share of its range.
        path: (P, n) self-motion from the present configuration; None if none is known.
    """

    q: Array
    energy: float
    values: dict[str, float]
    costs: dict[str, float]
    clearance: Clearance
    nearest_limit: str
    limit_share: float
    path: Array | None


@dataclass
class Pool:
    """The best configurations found so far.

    Attributes:
        q: (M, n) configurations, best first.
        energy: (M,) their energies.
    """

    q: Array
    energy: Array = field(default_factory=lambda: np.empty(0))

    def add(self, q: Array, energy: Array) -> None:
        """Take in configurations; the worst are forgotten."""
        good = np.isfinite(energy)
        q, energy = np.concatenate([self.q, q[good]]), np.concatenate([self.energy, energy[good]])
        order = np.argsort(energy, kind="stable")[: 4 * POOL]
        self.q, self.energy = q[order], energy[order]

    @property
    def best(self) -> float:
        """Least energy; infinite if there is none."""
        return float(self.energy[0]) if len(self.energy) else float("inf")

    def distinct(self, count: int, distance: float = DISTINCT) -> NDArray[np.intp]:
        """Indices of the best that differ from all better ones by more than `distance` in some joint."""
        left = np.ones(len(self.q), dtype=np.bool_)
        chosen: list[int] = []
        while left.any() and len(chosen) < count:
            best = int(np.argmax(left))
            chosen.append(best)
            left &= np.abs(self.q - self.q[best]).max(axis=1) > distance
        return np.array(chosen, dtype=np.intp)


def search(
    problem: Problem,
    generator: np.random.Generator,
    method: str = "annealing",
    effort: float = 1.0,
    go_on: Callable[[Progress], bool] = lambda _: True,
) -> Pool:
    """Find configurations of low energy, polished.

    Args:
        problem: the task.
        generator: of random numbers.
        method: one of `METHODS`.
        effort: of the method; 1 is what an operator waits for.
        go_on: asked after every step; once it says no, what was found so far is polished and returned.

    Returns:
        Distinct configurations, best first; empty if nothing was found.

    Raises:
        AdvisorError: no such method.
    """
    if method not in METHODS:
        raise AdvisorError(f"no method {method!r}; there are {', '.join(METHODS)}")
    pool = Pool(np.empty((0, problem.robot.n)))
    for found in METHODS[method](problem, generator, effort):
        pool.add(found.q, found.energy)
        if not go_on(Progress("searching", found.done, pool.best, problem.count)):
            break
    rough = pool.distinct(POLISHED, 2 * DISTINCT)
    go_on(Progress("polishing", 0.0, pool.best, problem.count))
    pool.add(*descend(problem, pool.q[rough], pool.energy[rough], generator, POLISH_STEPS))
    kept = pool.distinct(POOL)
    return Pool(pool.q[kept], pool.energy[kept])


def advise(
    problem: Problem,
    present: Array,
    *,
    generator: np.random.Generator,
    options: int = 5,
    method: str = "annealing",
    effort: float = 1.0,
    exact: ExactClearance | None = None,
    go_on: Callable[[Progress], bool] = lambda _: True,
) -> list[Option]:
    """Ranked, distinct options.

    Args:
        problem: the task.
        present: (n,) where the robot is; paths begin there if its hands are where the task has them.
        generator: of random numbers.
        options: how many at most.
        method: one of `METHODS`.
        effort: of the method.
        exact: measures clearance; one with the other robots at home if not given.
        go_on: asked after every step; once it says no, what is known is returned at once, without further paths.

    Returns:
        Options, best first.
    """
    exact = exact or ExactClearance(problem.cell, problem.robot.name)
    cancelled = False

    def ask(progress: Progress) -> bool:
        nonlocal cancelled
        cancelled = cancelled or not go_on(progress)
        return not cancelled

    pool = search(problem, generator, method, effort, ask)
    chosen: list[tuple[int, Clearance]] = []
    for index in range(len(pool.q)):
        clearance = exact.measure(pool.q[index])
        if clearance.room_m > 0.0:
            chosen.append((index, clearance))
        if len(chosen) == options:
            break
    ask(Progress("checking", 1.0, pool.best, problem.count))
    motion = SelfMotion(problem, exact, generator) if _hands_are_there(problem, present) else None
    found = []
    for number, (index, clearance) in enumerate(chosen):
        path = motion.path(present, pool.q[index]) if motion is not None and not cancelled else None
        found.append(_option(problem, pool.q[index], float(pool.energy[index]), clearance, path))
        ask(Progress("finding paths", (number + 1) / len(chosen), pool.best, problem.count))
    return found


def _hands_are_there(problem: Problem, q: Array) -> bool:
    off = problem.tracker.hands(q) - problem.poses
    return bool(np.abs(off[:, :3, 3]).max() < THERE_M and np.abs(off[:, :3, :3]).max() < THERE_RAD)


def _option(problem: Problem, q: Array, energy: float, clearance: Clearance, path: Array | None) -> Option:
    postures = Postures(problem.data, q)
    values = {criterion.name: float(criterion.value(postures)[0]) for criterion in TABLE}
    costs = {
        criterion.name: float(
            cost(criterion, problem.references[criterion.name], np.array([values[criterion.name]]))[0]
        )
        for criterion in TABLE
    }
    robot = problem.robot
    shares = np.minimum(q - robot.lower, robot.upper - q) / (robot.upper - robot.lower)
    nearest = int(np.argmin(shares))
    return Option(
        q, energy, values, costs, clearance, robot.joint_names[nearest], float(shares[nearest]), path
    )
