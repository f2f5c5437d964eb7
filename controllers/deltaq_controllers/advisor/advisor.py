"""The advisor: ranked configurations that hold the hands at given poses, each with a path to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from deltaq_controllers.advisor.exact import Clearance, ExactClearance
from deltaq_controllers.advisor.path_planner import NoPathError, PathPlanner
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.advisor.search import Pool, search
from deltaq_controllers.advisor.space import HandsKept, HandsMoved, Space
from deltaq_controllers.criteria import TABLE, Postures
from deltaq_controllers.criteria.normalised import cost
from deltaq_protocol.arrays import Array

THERE_M, THERE_RAD = 1e-4, 1e-3
"""The robot's hands count as being where they should be within this."""

DRIVABLE = 3
"""This many of the options can be driven to, if there are that many, even if others have less energy."""

MEASURED = 100
"""Configurations that are measured exactly to find the options."""

NOT_LOOKED_FOR = "not searched for yet"


@dataclass(frozen=True, eq=False)
class Option:
    """One configuration that holds the hands at the given poses.

    Attributes:
        q: (n,) configuration.
        energy: the weighted sum, by which options are ranked.
        values: value of every criterion, in its unit.
        costs: its cost, 0 good to 1 bad.
        clearance: exact, with the tightest pair.
        nearest_limit: the joint that is nearest to a limit of its own.
        limit_share: its distance from there as a fraction of its range.
        hands_move: whether the hands are elsewhere now, so that every path moves them.
        start: (n,) configuration from which a path is searched for.
        path: (P, n) from there, clear of everything; None if none is known.
        no_path: why not; empty if there is one.
    """

    q: Array
    energy: float
    values: dict[str, float]
    costs: dict[str, float]
    clearance: Clearance
    nearest_limit: str
    limit_share: float
    hands_move: bool
    start: Array
    path: Array | None = None
    no_path: str = NOT_LOOKED_FOR


@dataclass(frozen=True)
class Progress:
    """Progress of the advisor.

    Attributes:
        doing: `searching`, `polishing`, `checking` or `finding paths`.
        done: fraction of that step that is done.
        energy: least so far; infinite before the first.
        trials: so far.
        options: best first, once they are known; their paths follow one after the other.
    """

    doing: str
    done: float
    energy: float
    trials: int
    options: tuple[Option, ...] = ()


def advise(
    problem: AdvisorProblem,
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

    The best is always among them. Options behind a singularity are replaced by reachable ones until `DRIVABLE`
    are reachable.

    Args:
        problem: the task.
        present: (n,) where the robot is. If its hands are where the task has them, paths keep them there.
        generator: of random numbers.
        options: how many at most.
        method: one of `METHODS`.
        effort: of the method.
        exact: measures clearance; one with the other robots at home if not given.
        go_on: called after every step; once it returns False, the options found so far are returned at once.

    Returns:
        Options, best first.
    """
    exact = exact or ExactClearance(problem.cell, problem.robot.name)
    cancelled = False

    def ask(doing: str, done: float, energy: float, found: tuple[Option, ...] = ()) -> bool:
        nonlocal cancelled
        cancelled = cancelled or not go_on(Progress(doing, done, energy, problem.count, found))
        return not cancelled

    pool = search(problem, generator, method, effort, ask)
    there = hands_are_there(problem, present)
    space: Space = HandsKept(problem.tracker, problem.poses) if there else HandsMoved(problem.robot)
    found = _described(problem, pool, _chosen(pool, space, present, options, exact), present, not there)
    ask("checking", 1.0, pool.best, tuple(found))
    ways = PathPlanner(problem, space, exact, generator, present)
    for number, option in enumerate(found):
        try:
            path = ways.to(option.q, lambda: not cancelled)
            found[number] = replace(option, path=path, no_path="")
        except NoPathError as error:
            found[number] = replace(option, no_path=str(error))
        ask("finding paths", (number + 1) / len(found), pool.best, tuple(found))
    return found


def hands_are_there(problem: AdvisorProblem, q: Array) -> bool:
    """Whether the hands are where the task has them at `q` (n,)."""
    off = problem.tracker.hands(q) - problem.poses
    return bool(np.abs(off[:, :3, 3]).max() < THERE_M and np.abs(off[:, :3, :3]).max() < THERE_RAD)


def _chosen(
    pool: Pool, space: Space, present: Array, count: int, exact: ExactClearance
) -> list[tuple[int, Clearance]]:
    """Indices and clearances of the options, best first."""
    best: list[tuple[int, Clearance]] = []
    drivable: list[tuple[int, Clearance]] = []
    for index, q in enumerate(pool.q[:MEASURED]):
        clearance = exact.measure(q)
        if clearance.room_m <= 0.0:
            continue
        if len(best) < count:
            best.append((index, clearance))
        if not space.barred(present, q):
            drivable.append((index, clearance))
        if len(best) == count and len(drivable) >= DRIVABLE:
            break
    wanted = drivable[: min(DRIVABLE, count)]
    chosen = dict([*best[:1], *wanted, *best])
    return sorted(list(chosen.items())[:count])


def _described(
    problem: AdvisorProblem, pool: Pool, chosen: list[tuple[int, Clearance]], present: Array, hands_move: bool
) -> list[Option]:
    if not chosen:
        return []
    robot = problem.robot
    q = pool.q[[index for index, _ in chosen]]
    postures = Postures(problem.data, q)
    values = {criterion.name: criterion.value(postures) for criterion in TABLE}
    costs = {
        criterion.name: cost(criterion, problem.references[criterion.name], values[criterion.name])
        for criterion in TABLE
    }
    shares = np.minimum(q - robot.lower, robot.upper - q) / (robot.upper - robot.lower)
    nearest = shares.argmin(axis=1)
    return [
        Option(
            q=q[row],
            energy=float(pool.energy[index]),
            values={name: float(column[row]) for name, column in values.items()},
            costs={name: float(column[row]) for name, column in costs.items()},
            clearance=clearance,
            nearest_limit=robot.joint_names[nearest[row]],
            limit_share=float(shares[row, nearest[row]]),
            hands_move=hands_move,
            start=present,
        )
        for row, (index, clearance) in enumerate(chosen)
    ]
