"""Paths between configurations that keep the hands still.

They are straight in the free joints where that is clear; otherwise two trees grow towards each other (RRT-connect of
Kuffner and LaValle 2000, many extensions at once).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import Problem
from deltaq_controllers.criteria import Postures

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

REACH = 0.3
"""Longest extension of a tree, in any free joint [rad or m]."""
STEP = 0.05
"""Free joints between two configurations that are looked at while searching [rad or m]."""
FINE = 0.01
"""Free joints between two configurations of a path that is handed out [rad or m]."""
LEAP = 4.0
"""Times STEP by which an arm's joint may change over a step; more is another branch, or too near to a singularity."""
MARGIN_M = 0.015
"""Room that the search keeps where start and goal have it, so that the exact check agrees."""
AHEAD = 8
"""Steps that are solved at once, each on the branch nearest to where they start."""
CHECKED = 4
"""Of so many configurations of a path one is measured exactly; the gate measures every one that is driven."""
LIMIT_MARGIN = 0.05
"""Room to the joints' limits that a path keeps where start and goal have it, so that it can be braked [rad or m]."""
FINE_SHARE = 0.4
"""Share of the margins that is kept between the configurations that the search looked at."""
ROUNDED = 31
"""Configurations of a path over which a corner is rounded."""
EXTENSIONS = 24
"""Extensions tried at once."""


@dataclass
class _Tree:
    q: Array
    parent: list[int]

    def branch(self, node: int) -> list[Array]:
        """Configurations from the root to a node."""
        nodes = [node]
        while self.parent[nodes[-1]] >= 0:
            nodes.append(self.parent[nodes[-1]])
        return [self.q[k] for k in reversed(nodes)]


class SelfMotion:
    """Finds paths over which the hands stay where a problem has them.

    Args:
        problem: the task.
        exact: measures what is handed out.
        generator: of random numbers.
    """

    def __init__(self, problem: Problem, exact: ExactClearance, generator: np.random.Generator) -> None:
        self._problem, self._exact, self._generator = problem, exact, generator
        self._base = problem.tracker.base
        self._ends = np.stack([problem.robot.lower, problem.robot.upper])
        self._margin = 0.0

    def path(self, start: Array, goal: Array, rounds: int = 40) -> Array | None:
        """A path from one configuration to another.

        Args:
            start: (n,) with the hands where the problem has them.
            goal: (n,) too.
            rounds: how long to search; a round tries `EXTENSIONS` extensions of either tree.

        Returns:
            (P, n) configurations, neighbours no further apart than `FINE` in the free joints; None if none was found.
        """
        self._ends = np.stack([start, goal])
        room = Postures(self._problem.data, self._ends).nearest.room.min()
        self._margin = float(np.clip(0.8 * room, 0.0, MARGIN_M))
        corners = self._corners(start, goal, rounds)
        if corners is None:
            return None
        path = self._walked(self._shortened(corners), FINE)
        if path is None:
            path = self._walked(corners, FINE)
        path = None if path is None else self._rounded(path)
        if path is None or any(self._exact.measure(q).room_m < 0.0 for q in path[::CHECKED]):
            return None
        return path

    def _corners(self, start: Array, goal: Array, rounds: int) -> list[Array] | None:
        if self._walked([start, goal], STEP) is not None:
            return [start, goal]
        trees = (_Tree(start[None], [-1]), _Tree(goal[None], [-1]))
        for number in range(rounds):
            mine, theirs = trees if number % 2 == 0 else trees[::-1]
            grown = self._grown(mine, theirs)
            for node in grown[:4]:
                near = self._nearest(theirs, mine.q[node, self._base][None])[0]
                if self._walked([mine.q[node], theirs.q[near]], STEP) is not None:
                    there, back = mine.branch(node), theirs.branch(int(near))
                    corners = [*there, *reversed(back)]
                    return corners if number % 2 == 0 else corners[::-1]
        return None

    def _grown(self, tree: _Tree, other: _Tree) -> list[int]:
        """Extend a tree, partly at random and partly towards the other one; the new nodes, nearest to it first."""
        problem = self._problem
        targets = self._generator.uniform(problem.lower, problem.upper, (EXTENSIONS, problem.free))
        some = self._generator.integers(len(other.q), size=EXTENSIONS // 4)
        targets[: len(some)] = other.q[some][:, self._base]
        near = self._nearest(tree, targets)
        origin = tree.q[near]
        change = targets - origin[:, self._base]
        change *= np.minimum(1.0, REACH / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-9))
        q, arrived = origin, np.ones(EXTENSIONS, dtype=np.bool_)
        pieces = round(REACH / STEP)
        for piece in range(1, pieces + 1):
            following = problem.tracker.track(
                origin[:, self._base] + change * (piece / pieces), problem.poses, q
            )
            arrived &= self._joined(q, following)
            q = np.where(arrived[:, None], following, q)
        new = np.flatnonzero(arrived)
        clear = self._clear(q[new])
        new = new[clear]
        first = len(tree.q)
        tree.q = np.concatenate([tree.q, q[new]])
        tree.parent += near[new].tolist()
        distance = np.abs(tree.q[first:, None, self._base] - other.q[None, :, self._base]).max(axis=2)
        order = np.argsort(distance.min(axis=1)) if len(new) else np.empty(0, dtype=np.intp)
        return [first + int(node) for node in order]

    def _nearest(self, tree: _Tree, targets: Array) -> NDArray[np.intp]:
        nearest: NDArray[np.intp] = (
            np.abs(tree.q[None, :, self._base] - targets[:, None]).max(axis=2).argmin(axis=1)
        )
        return nearest

    def _shortened(self, corners: list[Array]) -> list[Array]:
        """Leave out corners where the straight way is clear."""
        corners = list(corners)
        first = 0
        while first < len(corners) - 2:
            for last in range(len(corners) - 1, first + 1, -1):
                if self._walked([corners[first], corners[last]], STEP) is not None:
                    del corners[first + 1 : last]
                    break
            first += 1
        return corners

    def _walked(self, corners: list[Array], step: float) -> Array | None:
        """The way from corner to corner, straight in the free joints; None if it is not clear or leaves a branch."""
        problem, way = self._problem, [corners[0]]
        for corner in corners[1:]:
            start = way[-1][self._base]
            change = corner[self._base] - start
            pieces = max(1, int(np.ceil(np.abs(change).max() / step)))
            for piece in range(1, pieces + 1):
                (q,) = problem.tracker.track(
                    (start + change * (piece / pieces))[None], problem.poses, way[-1]
                )
                if not self._joined(way[-1][None], q[None], step)[0]:
                    return None
                way.append(q)
            if np.abs(way[-1] - corner).max() > 1e-6:
                return None
        path = np.stack(way)
        return path if self._clear(path, FINE_SHARE if step == FINE else 1.0).all() else None

    def _rounded(self, path: Array) -> Array:
        """The path with its corners rounded, where that is clear; a corner would have to be passed at a crawl."""
        window = min(ROUNDED, 2 * ((len(path) - 1) // 2) + 1)
        half = window // 2
        base = path[:, self._base]
        # mirrored about either end, so that the ends stay where they are
        before, after = 2.0 * base[0] - base[half:0:-1], 2.0 * base[-1] - base[-2 : -half - 2 : -1]
        padded = np.concatenate([before, base, after])
        smooth = np.column_stack(
            [np.convolve(column, np.full(window, 1.0 / window), "valid") for column in padded.T]
        )
        rounded = self._problem.tracker.track(smooth, self._problem.poses, path)
        rounded[[0, -1]] = path[[0, -1]]
        whole = np.isfinite(rounded).all() and self._joined(rounded[:-1], rounded[1:], FINE).all()
        return rounded if whole and self._clear(rounded, FINE_SHARE).all() else path

    def _joined(self, before: Array, after: Array, step: float = STEP) -> Flags:
        """(N,) whether configurations follow one another without a leap."""
        joined: Flags = np.abs(after - before).max(axis=1) <= LEAP * step
        return joined

    def _clear(self, q: Array, share: float = 1.0) -> Flags:
        """(N,) whether configurations keep a share of the margins to bodies and limits."""
        if not len(q):
            return np.ones(0, dtype=np.bool_)
        robot, off = self._problem.robot, share * LIMIT_MARGIN
        low = np.minimum(robot.lower + off, self._ends.min(axis=0))
        high = np.maximum(robot.upper - off, self._ends.max(axis=0))
        within = np.all((q >= low) & (q <= high), axis=1)
        clear: Flags = within & (Postures(self._problem.data, q).nearest.room >= share * self._margin)
        return clear
