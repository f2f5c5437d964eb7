"""The configurations that a robot can reach with its hands in place: one component of its self-motion manifold.

With the hands fixed, most configurations lie on other branches of an arm, or behind limits and bodies. So the search
starts at the present configuration and stays within what can be reached from it: a tree spreads over the free joints,
and from its best nodes the energy descends along edges that are checked in the same way. Each configuration has a
path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from deltaq_controllers.advisor.path_planner import Tree
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.advisor.search import DISTINCT, descend
from deltaq_protocol.arrays import Array, Flags, Indices

ROUNDS = 16
"""How often the tree is grown."""
DESCENTS = 8
"""Nodes from which the energy descends, and the steps of that."""
STEPS = 12
ENOUGH = 5
"""A search goes on until it has so many nodes that differ by `DISTINCT`: some starts are boxed in."""
BETTER = 0.01
"""It has a second turn at least if nothing is better than the start by this fraction of its energy."""
POLISHED = 3
"""So many of the best nodes have a second descent."""
TURNS = 3
"""How often at most it spreads and descends, each time farther, and from nodes that differ less."""
TOGETHER = 8
"""So many descents are made side by side."""
LEAST_SINGULAR = 0.02
"""Least singular value of an arm's Jacobian at an option, unless the start has less. Closer to a singularity the speed
at which a brake leaves the hands in place goes to zero, and the robot does not arrive."""


class Component:
    """Configurations that can be reached from one, and their energies.

    Args:
        problem: the task.
        tree: its root is where the robot is.
        generator: of random numbers.

    Attributes:
        tree: as given; it grows.
        energy: (K,) energies of its nodes.
    """

    def __init__(self, problem: AdvisorProblem, tree: Tree, generator: np.random.Generator) -> None:
        self._problem, self.tree, self._generator = problem, tree, generator
        self._least = min(LEAST_SINGULAR, float(self._singular(tree.q).min()))
        self.energy = problem.energies(tree.q)

    def explore(self, effort: float, go_on: Callable[[float], bool]) -> None:
        """Spread, and descend from the best nodes; again, a few times, where too little is found.

        Args:
            effort: factor of the usual time.
            go_on: called with the fraction that is done; once it returns False, this ends.
        """
        ends = self.descend(np.zeros(1, dtype=np.intp), STEPS)
        for turn in range(1, TURNS + 1 if self._problem.free else 1):
            half = 0.5**turn  # of a bar that is not to stand still, nor to go back

            def goes_on(done: float, half: float = half) -> bool:
                return go_on(1.0 - half * (2.0 - done))

            if not self._spread(max(1, round(ROUNDS * turn * effort)), goes_on):
                break
            # a few at a time: what may be shown grows, and the operator may end it
            nodes = self.best(max(1, round(DESCENTS * effort)), ends, apart=DISTINCT / turn)
            for first in range(0, len(nodes), TOGETHER):
                if not goes_on(0.5 + 0.5 * first / len(nodes)):
                    return
                ends = np.append(ends, self.descend(nodes[first : first + TOGETHER], STEPS))
            is_better = self.energy[ends].min() < (1.0 - BETTER) * self.energy[0]
            if (is_better or turn >= 2) and len(self.best(ENOUGH)) == ENOUGH:
                break
        self.descend(self.best(POLISHED), STEPS)

    def _spread(self, rounds: int, go_on: Callable[[float], bool]) -> bool:
        """Grow the tree; returns whether to continue."""
        for number in range(rounds):
            if not go_on(0.5 * number / rounds):
                return False
            new = self.tree.spread(self._problem.lower, self._problem.upper, self._generator)
            self._problem.count += len(new)
            self._measure()
        return True

    def best(
        self,
        count: int,
        known: Sequence[int] | Indices = (),
        energy: Array | None = None,
        apart: float = DISTINCT,
    ) -> Indices:
        """The nodes of least energy that differ by `apart` from one another and from those known, at most `count`.

        Their edges hold. Another energy (K,) of the nodes may be given.
        """
        energy = self.energy if energy is None else energy
        q, left = self.tree.q[:, : self._problem.tracker.driven], np.isfinite(energy)
        for node in known:
            left &= np.abs(q - q[node]).max(axis=1) > apart
        chosen: list[int] = []
        while left.any() and len(chosen) < count:
            node = int(np.argmin(np.where(left, energy, np.inf)))
            left[node] = False
            if self.tree.holds(node):
                chosen.append(node)
                left &= np.abs(q - q[node]).max(axis=1) > apart
        return np.array(chosen, dtype=np.intp)

    def descend(self, nodes: Indices, steps: int, problem: AdvisorProblem | None = None) -> Indices:
        """Descend from nodes (k,) whose edges hold, by the energy of the task or of another with the same hands.

        Returns:
            (k,) nodes where that ends.
        """
        problem, at = problem or self._problem, nodes.copy()

        def accept(rows: Indices, to: Array) -> Flags:
            passes = self._singular(to) >= self._least
            passes[passes] = self.tree.ground.straight(self.tree.q[at[rows[passes]]], to[passes])
            at[rows[passes]] = self.tree.add(to[passes], at[rows[passes]], is_sure=True)
            return passes

        q = self.tree.q[at]
        descend(problem, q, problem.energies(q), self._generator, steps, accept)
        self._measure()
        return at

    def _measure(self) -> None:
        new = self.tree.q[len(self.energy) :]
        if len(new):
            energy = self._problem.energies(new)
            energy[self._singular(new) < self._least] = np.inf
            self.energy = np.append(self.energy, energy)

    def _singular(self, q: Array) -> Array:
        """(N,) least singular value of the Jacobian of any arm at configurations (N, n)."""
        J = self._problem.jacobians(q)
        arms = self._problem.tracker.arms
        least = [
            np.linalg.svd(J[:, k][:, :, arm.joints], compute_uv=False)[:, -1] for k, arm in enumerate(arms)
        ]
        singular: Array = np.min(least, axis=0)
        return singular
