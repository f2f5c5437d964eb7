"""The front of two criteria: configurations of which none is better in one without being worse in the other."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.advisor.component import STEPS, Component
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.criteria import Postures
from deltaq_protocol.arrays import Array, Indices

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Weights of the first criterion, the second having the rest, by which the energy descends."""
STARTS = 3
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
        component.descend(component.best(STARTS, np.empty(0, dtype=np.intp), energy), STEPS, weighed)
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
