"""The advisor: ranked configurations that hold the hands at given poses, each with a path to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from deltaq_controllers.advisor.component import STEPS, Component
from deltaq_controllers.advisor.exact import ExactClearance, HandsKept, HandsMoved, limit_margin
from deltaq_controllers.advisor.path_planner import NoPathError, PathPlanner, Tree
from deltaq_controllers.advisor.problem import AdvisorError, AdvisorProblem
from deltaq_controllers.advisor.search import DISTINCT, Pool, check_method, search
from deltaq_controllers.criteria import TABLE, Postures
from deltaq_controllers.criteria.near_bodies import Clearance, PairKind
from deltaq_controllers.criteria.table import cost
from deltaq_protocol.arrays import Array, Indices

# The front of two criteria: configurations of which none is better in one without being worse in the other.

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Weights of the first criterion, the second having the rest, by which the energy descends."""
STARTS = 10
"""Nodes from which it does, for each."""
APART = 0.01
"""Points of a front differ by more than this in the cost of either criterion."""


def front(component: Component, problem: AdvisorProblem, names: tuple[str, str], count: int) -> Indices:
    """Nodes of a component on the front of two criteria, the best by the first one first.

    Args:
        component: the explored component.
        problem: the task, of which only the hands count.
        names: of the criteria.
        count: how many at most; they are spread over the front, its ends among them.

    Raises:
        CriterionError: an unknown criterion.
    """
    first, second = names
    for share in SHARES:
        weighed = problem.weighed({first: share, second: 1.0 - share})
        energy = weighed.energies(component.tree.q)
        component.descend(component.best(STARTS, energy=energy), STEPS, weighed)
    both = problem.weighed({first: 1.0, second: 1.0})
    costs = both.energy.costs(Postures(problem.data, component.tree.q))
    costs[~np.isfinite(component.energy)] = np.inf
    nodes = [node for node in _undominated(costs).tolist() if component.tree.holds(node)]
    return _spread(np.array(nodes, dtype=np.intp), costs, count)


def _undominated(costs: Array) -> Indices:
    """Rows of (K, 2) costs that no other row beats, in the order of the first cost."""
    order = np.lexsort((costs[:, 1], costs[:, 0]))
    least = np.minimum.accumulate(costs[order, 1])
    better = np.append(True, costs[order[1:], 1] < least[:-1])
    undominated: Indices = order[better & np.isfinite(costs[order]).all(axis=1)]
    return undominated


def _spread(nodes: Indices, costs: Array, count: int) -> Indices:
    """At most `count` of some nodes: both ends, and then always the one that is farthest from those chosen."""
    if not len(nodes):
        return nodes
    at = costs[nodes]
    chosen = [0]
    distance = np.abs(at - at[0]).min(axis=1)
    while len(chosen) < count and distance.max() > APART:
        farthest = len(nodes) - 1 if len(chosen) == 1 and distance[-1] > APART else int(distance.argmax())
        chosen.append(farthest)
        distance = np.minimum(distance, np.abs(at - at[farthest]).min(axis=1))
    spread: Indices = nodes[sorted(chosen)]
    return spread


THERE_M, THERE_RAD = 1e-4, 1e-3
"""The robot's hands count as being where they should be within this."""

MEASURED = 100
"""Configurations that are measured exactly to find the options."""

AS_GOOD = 0.005
"""An option to which hands leave is not shown beside the best in place unless better by this fraction of its energy."""

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
        hands_leave: whether hands that stay in place leave their poses on the path and come back.
        energy_here: energy of the configuration from which the advisor was asked.
        nearest: for each kind of near body, the nearest pair whose distance the hands' poses do not determine.
        places: (h, 4, 4) the given poses of the hands; None where they do not matter.
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
    hands_leave: bool = False
    energy_here: float = float("nan")
    nearest: Mapping[PairKind, Clearance] = field(default_factory=dict)
    places: Array | None = None

    @classmethod
    def along(cls, path: Array, clearance: Clearance, hands_move: bool = True) -> Self:
        """The end of a path (P, n) that is known already, and not ranked among others."""
        return cls(
            path[-1],
            energy=0.0,
            values={},
            costs={},
            clearance=clearance,
            nearest_limit="",
            limit_share=0.0,
            hands_move=hands_move,
            start=path[0],
            path=path,
            no_path="",
        )


@dataclass(frozen=True)
class Progress:
    """Progress of the advisor.

    Attributes:
        doing: `searching`, `polishing`, `checking` or `finding paths`.
        done: fraction of that step that is done.
        energy: least so far; infinite before the first.
        trials: number of trials so far.
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
    trade_off: tuple[str, str] | None = None,
    go_on: Callable[[Progress], bool] = lambda _: True,
) -> list[Option]:
    """Ranked, distinct options.

    With the hands in place they are the best of all reachable configurations that differ by `DISTINCT`; or, with
    `trade_off`, points on the Pareto front of two criteria. If hands may leave their poses and return, configurations
    on other branches are options, too, and marked; options with a path come before those without. If hands are to
    move elsewhere, all configurations with the hands there are searched.

    Args:
        problem: the task.
        present: (n,) present configuration. If its hands are at the task's poses, paths keep them there.
        generator: of random numbers.
        options: how many at most.
        method: one of `METHODS`, for the search beyond what can be reached with the hands in place.
        effort: of the search.
        exact: measures clearance; by default with the other robots at home.
        trade_off: names of two criteria; options are on their Pareto front instead; the hands have to be in
            place.
        go_on: called after every step; once it returns False, the options found so far are returned at once.

    Returns:
        Options, best first; on a front sorted by the first criterion.

    Raises:
        AdvisorError: unknown method, or a front with the hands elsewhere.
        TaskError: a hand is to be outside its region.
        CriterionError: a front of an unknown criterion.
    """
    problem.task.check_region(problem.robot.hands, problem.poses)
    exact = exact or ExactClearance(problem.cell, problem.robot.name)
    return _Answer(problem, present, generator, options, exact, go_on).found(method, effort, trade_off)


class _Answer:
    """One answer of the advisor, filled in step by step."""

    def __init__(
        self,
        problem: AdvisorProblem,
        present: Array,
        generator: np.random.Generator,
        count: int,
        exact: ExactClearance,
        go_on: Callable[[Progress], bool],
    ) -> None:
        self._problem, self._present, self._generator = problem, present, generator
        self._driven = problem.tracker.driven
        self._count, self._exact, self._go_on = count, exact, go_on
        self._ended = False
        self._best = float("inf")

    def found(self, method: str, effort: float, trade_off: tuple[str, str] | None) -> list[Option]:
        problem, present = self._problem, self._present
        check_method(method)
        own = problem.tracker.own
        moved = PathPlanner(own, HandsMoved(own, problem.task), self._exact, self._generator, present)
        start = problem.tracker.with_tolerances(present, problem.poses)
        if not hands_are_there(problem, start):
            if trade_off is not None:
                raise AdvisorError("a trade-off is looked for with the hands in place; leave out their poses")
            pool = self._searched(method, effort)
            found = self._described(*self._clear(pool, self._count), hands_move=True, hands_leave=False)
            return self._with_paths(differing(found), moved, moved)
        space = HandsKept(problem.tracker, problem.poses)
        kept = PathPlanner(problem.robot, space, self._exact, self._generator, start)
        found = self._reached(kept.tree, effort, trade_off)
        if problem.hands_may_leave and trade_off is None:
            found = differing(found + self._left(self._searched(method, effort), found))
        return self._with_paths(found, kept, moved)

    def _reached(self, tree: Tree, effort: float, trade_off: tuple[str, str] | None) -> list[Option]:
        """Options with the hands in place all the way, best first."""
        component = Component(self._problem, tree, self._generator)

        def go_on(done: float) -> bool:
            self._best = min(self._best, float(component.energy.min()))
            return self._ask("searching", done)

        component.explore(effort, go_on)
        self._ask("polishing", 0.0)
        nodes = (
            component.best(self._count)
            if trade_off is None
            else front(component, self._problem, trade_off, self._count)
        )
        self._best = min(self._best, float(component.energy.min()))
        return self._described(tree.q[nodes], component.energy[nodes], hands_move=False, hands_leave=False)

    def _left(self, pool: Pool, known: list[Option]) -> list[Option]:
        """Options to which the hands leave: on other branches, or turned by a whole turn, or behind something."""
        q, energy = self._clear(pool, self._count + len(known))
        other = np.abs(q[:, : self._driven] - self._present).max(axis=1, initial=0.0) > DISTINCT
        q, energy = q[other][: self._count], energy[other][: self._count]
        return self._described(q, energy, hands_move=True, hands_leave=True)

    def _searched(self, method: str, effort: float) -> Pool:
        def go_on(doing: str, done: float, energy: float) -> bool:
            self._best = min(self._best, energy)
            return self._ask(doing, done)

        inside = self._problem.inside(limit_margin(self._problem.robot))
        return search(inside, self._generator, method, effort, go_on)

    def _clear(self, pool: Pool, count: int) -> tuple[Array, Array]:
        """The best of a pool that are clear by the exact shapes."""
        chosen: list[int] = []
        for index, q in enumerate(pool.q[:MEASURED]):
            if len(chosen) == count:
                break
            if self._exact.keeps(q[None]):
                chosen.append(index)
        return pool.q[chosen], pool.energy[chosen]

    def _with_paths(self, found: list[Option], kept: PathPlanner, moved: PathPlanner) -> list[Option]:
        """The options with their paths, so many as were asked for.

        Which of more than that stay is known once their paths are; they are shown then, since a rank that has been
        shown keeps its option.
        """
        is_settled = len(found) <= self._count
        self._ask("checking", 1.0, tuple(found) if is_settled else ())
        best_in_place = next((number for number, one in enumerate(found) if not one.hands_leave), 0)
        for number in sorted(range(len(found)), key=lambda number: number != best_in_place):
            option = found[number]
            if sum(known.path is not None for known in found) == self._count:
                break
            ways, goal = moved, option.q
            if not option.hands_move:
                ways, goal = kept, self._problem.tracker.with_tolerances(goal, self._problem.poses)
            try:
                is_here = (option.q == self._present).all()
                path = self._present[None] if is_here else ways.to(goal, lambda: not self._ended)
                found[number] = replace(option, path=path[:, : self._driven], no_path="")
            except NoPathError as error:
                found[number] = replace(option, no_path=str(error))
            self._ask("finding paths", (number + 1) / len(found), tuple(found) if is_settled else ())
        if not is_settled:
            found = kept_of(found, self._count)
            self._ask("finding paths", 1.0, tuple(found))
        return found

    def _ask(self, doing: str, done: float, found: tuple[Option, ...] = ()) -> bool:
        progress = Progress(doing, done, self._best, self._problem.count, found)
        self._ended = self._ended or not self._go_on(progress)
        return not self._ended

    def _described(self, q: Array, energy: Array, *, hands_move: bool, hands_leave: bool) -> list[Option]:
        if not len(q):
            return []
        problem, robot = self._problem, self._problem.data.robot
        postures, q = Postures(problem.data, q), q[:, : self._driven]
        values = {criterion.name: criterion.value(postures) for criterion in TABLE}
        costs = {
            criterion.name: cost(criterion, problem.references[criterion.name], values[criterion.name])
            for criterion in TABLE
        }
        shares = np.minimum(q - robot.lower, robot.upper - q) / (robot.upper - robot.lower)
        nearest = shares.argmin(axis=1)
        here = float(problem.energies(self._present[None])[0])
        return [
            Option(
                q=q[row],
                energy=float(energy[row]),
                values={name: float(column[row]) for name, column in values.items()},
                costs={name: float(column[row]) for name, column in costs.items()},
                clearance=self._exact.measure(q[row]),
                nearest_limit=robot.joint_names[nearest[row]],
                limit_share=float(shares[row, nearest[row]]),
                hands_move=hands_move,
                start=self._present,
                hands_leave=hands_leave,
                energy_here=here,
                nearest=problem.data.bodies.nearest(q[row]),
                places=problem.poses,
            )
            for row in range(len(q))
        ]


def differing(found: Sequence[Option]) -> list[Option]:
    """Of options that do not differ by `DISTINCT` the better one, best first.

    The first one given stays, and hides those about it that are not better by `AS_GOOD`.
    """
    kept: list[Option] = []
    for option in sorted(found, key=lambda one: one.energy * (1.0 - AS_GOOD * (one is found[0]))):
        if option is found[0] or all(np.abs(option.q - other.q).max() > DISTINCT for other in kept):
            kept.append(option)
    return sorted(kept, key=lambda option: option.energy)


def kept_of(found: Sequence[Option], count: int) -> list[Option]:
    """Those with a path before those without, best first; the best that keeps the hands in place is always kept."""

    def worth(option: Option) -> tuple[bool, float]:
        return option.path is None, option.energy

    best_in_place = min((option for option in found if not option.hands_leave), key=worth, default=None)
    first = sorted(found, key=lambda option: (option is not best_in_place, *worth(option)))[:count]
    return sorted(first, key=lambda option: option.energy)


def hands_are_there(problem: AdvisorProblem, q: Array) -> bool:
    """Whether the hands have the task's poses at `q` (n,)."""
    off = problem.tracker.hands(q) - problem.poses
    return bool(np.abs(off[:, :3, 3]).max() < THERE_M and np.abs(off[:, :3, :3]).max() < THERE_RAD)
