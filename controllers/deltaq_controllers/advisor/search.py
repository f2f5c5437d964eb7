"""The search: a global method, local polish, and distinct configurations of low energy, best first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.advisor.descent import descend
from deltaq_controllers.advisor.methods import METHODS
from deltaq_controllers.advisor.problem import AdvisorError, AdvisorProblem
from deltaq_protocol.arrays import Array

DISTINCT = 0.25
"""Options differ by more than this in at least one joint [rad or m]."""

POLISHED, POLISH_STEPS = 32, 15
"""How many configurations are polished, and how far."""

POOL = 400
"""Configurations that are kept while searching."""


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
        """Add configurations; the worst are forgotten."""
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
    problem: AdvisorProblem,
    generator: np.random.Generator,
    method: str = "annealing",
    effort: float = 1.0,
    go_on: Callable[[str, float, float], bool] = lambda *_: True,
) -> Pool:
    """Find configurations of low energy, polished.

    Args:
        problem: the task.
        generator: of random numbers.
        method: one of `METHODS`.
        effort: of the method; 1 is what an operator waits for.
        go_on: called with the present activity, its completed fraction and the least energy so far; once it returns
            False, the findings so far are polished and returned.

    Returns:
        Distinct configurations, best first; empty if nothing was found.

    Raises:
        AdvisorError: no such method.
    """
    check_method(method)
    pool = Pool(np.empty((0, problem.robot.n)))
    for found in METHODS[method](problem, generator, effort):
        pool.add(found.q, found.energy)
        if not go_on("searching", found.done, pool.best):
            break
    rough = pool.distinct(POLISHED, 2 * DISTINCT)
    go_on("polishing", 0.0, pool.best)
    pool.add(*descend(problem, pool.q[rough], pool.energy[rough], generator, POLISH_STEPS))
    kept = pool.distinct(POOL)
    return Pool(pool.q[kept], pool.energy[kept])


def check_method(name: str) -> None:
    """Raise an `AdvisorError` for a method that there is none."""
    if name not in METHODS:
        raise AdvisorError(f"no method {name!r}; there are {', '.join(METHODS)}")
