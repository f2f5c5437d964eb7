"""Collision-free ways from one configuration to another, the hands kept still or not.

They are straight in the free joints where that is clear; otherwise two trees grow towards each other (RRT-connect of
Kuffner and LaValle 2000, many extensions at once).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import Problem
from deltaq_controllers.advisor.space import Space
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
"""Times STEP by which any joint may change over a step; more is another branch, or too near to a singularity."""
MARGIN_M = 0.015
"""Room that the search keeps where start and goal have it, so that the exact check agrees."""
CHECKED = 4
"""Of so many configurations of a path one is measured exactly; the gate measures every one that is driven."""
SAMPLED = 6
"""Of so many configurations of a way one is looked at first."""
LIMIT_MARGIN = 0.05
"""Room to the joints' limits that a path keeps where start and goal have it, so that it can be braked [rad or m]."""
FINE_SHARE = 0.4
"""Share of the margins that is kept between the configurations that the search looked at."""
ROUNDED = 31
"""Configurations of a path over which a corner is rounded."""
EXTENSIONS = 24
"""Extensions tried at once."""


class NoWayError(Exception):
    """There is no way, or none was found; the text says why."""


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


class Ways:
    """Finds ways.

    Args:
        problem: the task, for the robot and the bodies about.
        space: in which to look.
        exact: measures what is handed out.
        generator: of random numbers.
    """

    def __init__(
        self, problem: Problem, space: Space, exact: ExactClearance, generator: np.random.Generator
    ) -> None:
        self._problem, self._space, self._exact, self._generator = problem, space, exact, generator
        self._free = space.free
        self._lower = problem.robot.lower[space.free]
        self._upper = problem.robot.upper[space.free]
        self._ends = np.stack([problem.robot.lower, problem.robot.upper])
        self._margin = 0.0

    def path(
        self, start: Array, goal: Array, rounds: int = 40, go_on: Callable[[], bool] = lambda: True
    ) -> Array:
        """A path from one configuration to another.

        Args:
            start: (n,) in the space.
            goal: (n,) too.
            rounds: how long to search; a round tries `EXTENSIONS` extensions of one tree.
            go_on: asked every round.

        Returns:
            (P, n) configurations, neighbours no further apart than `FINE` in the free joints.

        Raises:
            NoWayError: there is none, or none was found.
        """
        barred = self._space.barred(start, goal)
        if barred:
            raise NoWayError(barred)
        self._ends = np.stack([start, goal])
        room = Postures(self._problem.data, self._ends).nearest.room.min()
        for wider in (1.0, 2.0):
            self._margin = float(np.clip(0.8 * room, 0.0, wider * MARGIN_M))
            corners = self._corners(start, goal, rounds, go_on)
            short = self._walked(self._shortened(corners), FINE)
            whole = [] if short is None else [self._rounded(short), short]
            for path in (*whole, self._walked(corners, FINE)):
                if path is not None and self._is_clear_exactly(path):
                    return path
        raise NoWayError("the ways that were found are too narrow")

    def _is_clear_exactly(self, path: Array) -> bool:
        return all(self._exact.measure(q).room_m > 0.0 for q in path[::CHECKED])

    def _corners(self, start: Array, goal: Array, rounds: int, go_on: Callable[[], bool]) -> list[Array]:
        if self._walked([start, goal], STEP) is not None:
            return [start, goal]
        trees = (_Tree(start[None], [-1]), _Tree(goal[None], [-1]))
        for number in range(rounds):
            if not go_on():
                raise NoWayError("the search for a way was ended")
            mine, theirs = trees if number % 2 == 0 else trees[::-1]
            grown = self._grown(mine, theirs)
            for node in grown[:4]:
                near = self._nearest(theirs, mine.q[node, self._free][None])[0]
                if self._walked([mine.q[node], theirs.q[near]], STEP) is not None:
                    there, back = mine.branch(node), theirs.branch(int(near))
                    corners = [*there, *reversed(back)]
                    return corners if number % 2 == 0 else corners[::-1]
        raise NoWayError("no clear way was found in the time that is taken")

    def _grown(self, tree: _Tree, other: _Tree) -> list[int]:
        """Extend a tree, partly at random and partly towards the other one; the new nodes, nearest to it first."""
        targets = self._generator.uniform(self._lower, self._upper, (EXTENSIONS, len(self._free)))
        some = self._generator.integers(len(other.q), size=EXTENSIONS // 4)
        targets[: len(some)] = other.q[some][:, self._free]
        near = self._nearest(tree, targets)
        origin = tree.q[near]
        change = targets - origin[:, self._free]
        change *= np.minimum(1.0, REACH / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-9))
        walked = self._space.walk(origin, origin[:, self._free] + change, round(REACH / STEP))
        # as far as it goes without a leap
        joined = self._joined(walked[:, :-1], walked[:, 1:]).all(axis=1)
        new = np.flatnonzero(joined)
        q = walked[new, -1]
        clear = self._clear(q)
        first = len(tree.q)
        tree.q = np.concatenate([tree.q, q[clear]])
        tree.parent += near[new[clear]].tolist()
        distance = np.abs(tree.q[first:, None, self._free] - other.q[None, :, self._free]).max(axis=2)
        order = np.argsort(distance.min(axis=1)) if clear.any() else np.empty(0, dtype=np.intp)
        return [first + int(node) for node in order]

    def _nearest(self, tree: _Tree, targets: Array) -> NDArray[np.intp]:
        nearest: NDArray[np.intp] = (
            np.abs(tree.q[None, :, self._free] - targets[:, None]).max(axis=2).argmin(axis=1)
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
        legs = [corners[0][None]]
        for corner in corners[1:]:
            start = legs[-1][-1]
            change = np.abs(corner[self._free] - start[self._free]).max()
            (leg,) = self._space.walk(
                start[None], corner[None, self._free], max(1, int(np.ceil(change / step)))
            )
            if not self._joined(leg[:-1], leg[1:], step).all() or np.abs(leg[-1] - corner).max() > 1e-6:
                return None
            legs.append(leg[1:])
        path, share = np.concatenate(legs), FINE_SHARE if step == FINE else 1.0
        # most ways that are barred are so over a good part
        return path if self._clear(path[::SAMPLED], share).all() and self._clear(path, share).all() else None

    def _rounded(self, path: Array) -> Array:
        """The path with its corners rounded, where that is clear; a corner would have to be passed at a crawl."""
        window = min(ROUNDED, 2 * ((len(path) - 1) // 2) + 1)
        half = window // 2
        free = path[:, self._free]
        # mirrored about either end, so that the ends stay where they are
        before, after = 2.0 * free[0] - free[half:0:-1], 2.0 * free[-1] - free[-2 : -half - 2 : -1]
        padded = np.concatenate([before, free, after])
        smooth = np.column_stack(
            [np.convolve(column, np.full(window, 1.0 / window), "valid") for column in padded.T]
        )
        rounded = self._space.placed(smooth, path)
        rounded[[0, -1]] = path[[0, -1]]
        whole = np.isfinite(rounded).all() and self._joined(rounded[:-1], rounded[1:], FINE).all()
        return rounded if whole and self._clear(rounded, FINE_SHARE).all() else path

    def _joined(self, before: Array, after: Array, step: float = STEP) -> Flags:
        """(...) whether configurations (..., n) follow one another without a leap."""
        joined: Flags = np.abs(after - before).max(axis=-1) <= LEAP * step
        return joined

    def _clear(self, q: Array, share: float = 1.0) -> Flags:
        """(N,) whether configurations keep a share of the margins to bodies and limits."""
        if not len(q):
            return np.ones(0, dtype=np.bool_)
        robot, off = self._problem.robot, share * LIMIT_MARGIN
        low = np.minimum(robot.lower + off, self._ends.min(axis=0))
        high = np.maximum(robot.upper - off, self._ends.max(axis=0))
        clear: Flags = np.all((q >= low) & (q <= high), axis=1)
        within = np.flatnonzero(clear)
        room = Postures(self._problem.data, q[within]).nearest.room
        clear[within] = room >= share * self._margin
        return clear
