"""Trees of configurations that grow towards each other: RRT-connect of Kuffner and LaValle 2000.

Many extensions are tried at once. A new node is checked halfway and at its own position, and its whole edge only
once a path uses it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deltaq_controllers.advisor.motion_validator import MotionValidator
from deltaq_protocol.arrays import Array, Indices

REACH = 0.3
"""Longest extension of a tree, in any free joint [rad or m]."""
EXTENSIONS = 24
"""Extensions tried at once."""
TOWARDS = 6
"""Of these so many go towards nodes of the other tree."""
LINKS = 4
"""Straight paths between the trees that are tried at once."""


class Tree:
    """Configurations that can be reached from a root.

    Args:
        root: (n,) configuration.
        ground: what its edges may pass.

    Attributes:
        ground: as given.
        q: (K, n) nodes, the root first.
    """

    def __init__(self, root: Array, ground: MotionValidator) -> None:
        self.ground = ground
        self.q: Array = root[None]
        self._parent = np.array([-1])
        self._is_sure = np.array([True])
        self._is_cut = np.array([False])

    def __len__(self) -> int:
        return len(self.q)

    def add(self, q: Array, parents: Indices, is_sure: bool = False) -> Indices:
        """Add nodes (k, n); `is_sure` if their edges have been checked over their whole length. Their numbers."""
        first = len(self.q)
        self.q = np.concatenate([self.q, q])
        self._parent = np.append(self._parent, parents)
        self._is_sure = np.append(self._is_sure, np.full(len(q), is_sure))
        self._is_cut = np.append(self._is_cut, np.zeros(len(q), dtype=np.bool_))
        return np.arange(first, len(self.q))

    def nearest(self, targets: Array) -> Indices:
        """(k,) the nodes nearest to free joints (k, m)."""
        nearest: Indices = self._distances(targets).argmin(axis=1)
        return nearest

    def near(self, target: Array, count: int) -> Indices:
        """The nodes nearest to free joints (m,), at most `count`."""
        (distances,) = self._distances(target[None])
        nodes: Indices = np.argsort(distances)[:count]
        whole: Indices = nodes[np.isfinite(distances[nodes])]
        return whole

    def branch(self, node: int) -> list[int]:
        """Nodes from the root to a node."""
        nodes = [node]
        while self._parent[nodes[-1]] >= 0:
            nodes.append(int(self._parent[nodes[-1]]))
        return nodes[::-1]

    def holds(self, node: int) -> bool:
        """Whether all edges from the root to a node are clear; one that is not is cut, with what hangs on it."""
        if self._is_cut[node]:
            return False
        unsure = [n for n in self.branch(node) if not self._is_sure[n]]
        if unsure:
            clear = self.ground.straight(self.q[self._parent[unsure]], self.q[unsure])
            self._is_sure[unsure] = clear
            self._is_cut[unsure] = ~clear
            for n in range(1, len(self)):  # parents come before their children
                self._is_cut[n] |= self._is_cut[self._parent[n]]
        return not self._is_cut[node]

    def grow(self, other: Tree, lower: Array, upper: Array, generator: np.random.Generator) -> Indices:
        """Extend towards random free joints between `lower` and `upper` (m,), and some nodes of another tree.

        Returns:
            The new nodes, nearest to the other tree first.
        """
        free = self.ground.space.free
        targets = generator.uniform(lower, upper, (EXTENSIONS, len(free)))
        targets[:TOWARDS] = other.q[generator.integers(len(other), size=TOWARDS)][:, free]
        new = self.extend(targets)
        nearest_first: Indices = new[np.argsort(other._distances(self.q[new][:, free]).min(axis=1))]
        return nearest_first

    def spread(self, lower: Array, upper: Array, generator: np.random.Generator) -> Indices:
        """Extend towards random free joints between `lower` and `upper` (m,), half of them about nodes of its own.

        Returns:
            The new nodes.
        """
        free = self.ground.space.free
        targets = generator.uniform(lower, upper, (EXTENSIONS, len(free)))
        half = EXTENSIONS // 2
        about = self.q[generator.integers(len(self), size=half)][:, free]
        targets[:half] = np.clip(about + generator.normal(size=about.shape) * REACH, lower, upper)
        return self.extend(targets)

    def extend(self, targets: Array) -> Indices:
        """Extend the nearest nodes towards free joints (k, m), by `REACH` at most; returns the new nodes."""
        free = self.ground.space.free
        parents = self.nearest(targets)
        origin = self.q[parents]
        change = targets - origin[:, free]
        change *= np.minimum(1.0, REACH / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-9))
        way, passes = self.ground.walk(origin, origin[:, free] + change)
        for place in (way.shape[1] - 1, way.shape[1] // 2):
            passes[passes] = self.ground.clear(way[passes, place])
        return self.add(way[passes, -1], parents[passes])

    def _distances(self, targets: Array) -> Array:
        """(k, K) distances of the nodes from free joints (k, m); infinite for those that are cut off."""
        distances: Array = np.abs(self.q[:, self.ground.space.free] - targets[:, None]).max(axis=2)
        return np.where(self._is_cut, np.inf, distances)


def linked(tree: Tree, nodes: Indices, other: Tree, others: Indices, ground: MotionValidator) -> Array | None:
    """(k, n) corners of a path from one tree's root to the other's, straight from a node to one of the other's nodes.

    Args:
        tree: where it begins.
        nodes: (k,) of this tree, each tried with the node of `others` at the same place.
        other: where it ends.
        others: (k,) nodes of the other tree.
        ground: what the path may pass between the trees.

    Returns:
        None if there is none.
    """
    if not len(nodes):
        return None
    for k in np.flatnonzero(ground.straight(tree.q[nodes], other.q[others])):
        node, other_node = int(nodes[k]), int(others[k])
        if tree.holds(node) and other.holds(other_node):
            there, back = tree.branch(node), other.branch(other_node)[::-1]
            return np.concatenate([tree.q[there], other.q[back]])
    return None


def connected(
    tree: Tree,
    goal: Array,
    ground: MotionValidator,
    limits: tuple[Array, Array],
    generator: np.random.Generator,
    rounds: int,
    go_on: Callable[[], bool],
) -> Array | None:
    """(k, n) corners of a path from a tree's root to a goal; nodes found meanwhile stay in the tree.

    Args:
        tree: a tree, which may have grown already.
        goal: (n,) configuration.
        ground: what paths to the goal may pass.
        limits: (m,) lower and upper limits of the free joints.
        generator: of random numbers.
        rounds: how often a tree is grown.
        go_on: asked every round.

    Returns:
        None if none was found.
    """
    free = ground.space.free
    goals = Tree(goal, ground)
    near = tree.near(goal[free], LINKS)
    corners = linked(tree, near, goals, np.zeros_like(near), ground)
    for number in range(rounds):
        if corners is not None or not go_on():
            break
        growing, waiting = (goals, tree) if number % 2 == 0 else (tree, goals)
        new = growing.grow(waiting, *limits, generator)[:LINKS]
        met = waiting.nearest(growing.q[new][:, free])
        nodes, others = (new, met) if growing is tree else (met, new)
        corners = linked(tree, nodes, goals, others, ground)
    return corners
