"""Collision-free paths from one configuration to others, with the hands fixed or not.

They are straight in the free joints where that is clear; otherwise two trees grow towards each other. The tree about
the start is kept, so that the path to one goal helps to find that to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.exact import (
    FINE,
    FINE_SHARE,
    LEAP,
    MARGIN_M,
    ExactClearance,
    MotionValidator,
    Space,
)
from deltaq_protocol.arrays import Array, Indices

# Trees of configurations that grow towards each other: RRT-connect of Kuffner and LaValle 2000.
#
# Many extensions are tried at once. A new node is checked halfway and at its own position, and its whole edge only
# once a path uses it.


REACH = 0.3
"""Longest extension of a tree, in any free joint [rad or m]."""
NARROW = 0.03
"""Shortest random extension about a node, as a fraction of `REACH`."""
EXTENSIONS = 24
"""Number of extensions tried at once."""
TOWARDS = 6
"""Number of them that go towards nodes of the other tree."""
LINKS = 4
"""Number of straight paths between the trees that are tried at once."""


class Tree:
    """Configurations that can be reached from a root.

    Args:
        root: (n,) configuration.
        ground: decides which edges are allowed.

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
        """Add nodes (k, n); `is_sure` if their edges are checked already. Returns their numbers."""
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
        """Whether all edges from the root to a node are clear; a blocked edge is cut with its subtree."""
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
        # some of them short: next to a limit or a singularity a long one has no first step
        reach = REACH * NARROW ** np.maximum(0.0, generator.uniform(-1.0, 1.0, (half, 1)))
        targets[:half] = np.clip(about + generator.normal(size=about.shape) * reach, lower, upper)
        return self.extend(targets)

    def extend(self, targets: Array) -> Indices:
        """Extend the nearest nodes towards free joints (k, m), by `REACH` at most, as far as a joint may go.

        Returns:
            The new nodes.
        """
        free = self.ground.space.free
        parents = self.nearest(targets)
        origin = self.q[parents]
        change = targets - origin[:, free]
        change *= np.minimum(1.0, REACH / np.maximum(np.abs(change).max(axis=1, keepdims=True), 1e-9))
        way, last = self.ground.walk(origin, origin[:, free] + change)
        passes, rows = last > 0, np.arange(len(way))
        for place in (last, (last + 1) // 2):
            passes[passes] = self.ground.clear(way[rows, place][passes])
        return self.add(way[rows, last][passes], parents[passes])

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
    """(k, n) corners of a path from a tree's root to a goal; nodes found on the way stay in the tree.

    Args:
        tree: a tree, which may have grown already.
        goal: (n,) configuration.
        ground: decides which paths to the goal are allowed.
        limits: (m,) lower and upper limits of the free joints.
        generator: of random numbers.
        rounds: how often a tree is grown.
        go_on: called every round; False ends the search.

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


# The beginning of a path where a robot stands close to a body: first away from it.
#
# A robot that was driven by hand until the gate stopped it stands at its stop distance. On a path that
# begins along the body the gate, which has to be able to brake, holds it; so paths begin where there is
# room.

_PROBED = 1e-4
"""Change of a joint by which its effect on the room is found [rad or m]."""
_MOST = 60
"""Steps of `FINE`; most bodies are parted within ten."""


def parted(robot: RobotModel, space: Space, exact: ExactClearance, start: Array, enough_m: float) -> Array:
    """A path that increases the distance of the nearest pair, by steepest ascent.

    Args:
        robot: its joint limits are kept.
        space: that the path lies in.
        exact: measures clearance.
        start: (n,) its first configuration, in the space.
        enough_m: room at which it ends.

    Returns:
        (P, n) configurations, `start` first, neighbours no further apart than `FINE` in the free joints. It ends
        earlier where no joint increases the distance; it is `start` alone if there is room already, or no direction
        to any.
    """
    way, room_m = [start], exact.measure(start).room_m
    while room_m < enough_m and len(way) < _MOST:
        rates = _rates(space, exact, way[-1], room_m)
        if not rates.any():
            break
        target = way[-1][space.free] + FINE * rates / np.abs(rates).max()
        q = _reached(space, way[-1], np.clip(target, robot.lower[space.free], robot.upper[space.free]))
        if q is None or (q < robot.lower).any() or (q > robot.upper).any():
            break
        if np.abs(q - way[-1]).max() > LEAP * FINE or (gained_m := exact.measure(q).room_m) <= room_m:
            break
        way.append(q)
        room_m = gained_m
    return np.array(way)


def _rates(space: Space, exact: ExactClearance, q: Array, room_m: float) -> Array:
    """(m,) gain of room per unit of each free joint; zero where the hands cannot be kept."""
    rates = np.zeros(len(space.free))
    for index, offset in enumerate(_PROBED * np.eye(len(space.free))):
        probed = _reached(space, q, q[space.free] + offset)
        if probed is not None:
            rates[index] = (exact.measure(probed).room_m - room_m) / _PROBED
    return rates


def _reached(space: Space, q: Array, target: Array) -> Array | None:
    """Where straight motion of the free joints to (m,) ends; None if there is no way."""
    reached: Array = space.walk(q[None], target[None], 1)[0, -1]
    return None if np.isnan(reached).any() else reached


ROUNDS = 60
"""How often a tree is grown in search of one path."""
CHECKED = 2
"""One of this many configurations of a path is measured exactly; the gate measures every one that is driven."""
ROUNDED = 31
"""Configurations of a path over which a corner is rounded."""
WIDER = (1.0, 2.0)
"""Factors of the margin to bodies with which a path is searched for, one after the other."""


class NoPathError(Exception):
    """There is no path, or none was found; the text says why."""


class PathPlanner:
    """Finds paths from one configuration.

    Args:
        robot: the robot, whose limits are kept.
        space: the search space.
        exact: measures the paths that are returned.
        generator: of random numbers.
        start: (n,) where they begin, in the space.
        rounds: how often a tree is grown in search of one path.
    """

    def __init__(
        self,
        robot: RobotModel,
        space: Space,
        exact: ExactClearance,
        generator: np.random.Generator,
        start: Array,
        rounds: int = ROUNDS,
    ) -> None:
        self._rounds = rounds
        self._robot, self._space, self._exact, self._generator = robot, space, exact, generator
        self._way_out = parted(robot, space, exact, start, FINE_SHARE * MARGIN_M)
        self._start = self._way_out[-1]
        self._limits = robot.lower[space.free], robot.upper[space.free]
        self._trees: dict[float, Tree] = {}

    def to(self, goal: Array, go_on: Callable[[], bool] = lambda: True) -> Array:
        """A path to a configuration.

        Args:
            goal: (n,) in the space.
            go_on: called now and then; False ends the search.

        Returns:
            (P, n) configurations, neighbours no further apart than `FINE` in the free joints. Close to a body they
            begin with a path away from it.

        Raises:
            NoPathError: there is none, or none was found.
        """
        barred = self._space.barred(self._start, goal)
        if barred:
            raise NoPathError(barred)
        ends = np.stack([self._start, goal])
        room_m = min(FINE_SHARE * MARGIN_M, *(max(0.0, 0.8 * self._exact.measure(q).room_m) for q in ends))
        for wider in WIDER:
            ground = self._ground(ends, wider)
            corners = connected(
                self._tree(wider), goal, ground, self._limits, self._generator, self._rounds, go_on
            )
            if not go_on():
                raise NoPathError("the search for a path was ended")
            if corners is None:
                raise NoPathError("no collision-free path was found within the search time")
            for path in _paths(ground, corners):
                if ground.within(path, FINE_SHARE).all() and self._exact.keeps(path[::CHECKED], room_m):
                    return np.concatenate([self._way_out[:-1], path])
        raise NoPathError("all paths found pass too close to limits or obstacles")

    @property
    def tree(self) -> Tree:
        """The nodes that can be reached from the start, as far as it has been searched."""
        return self._tree(WIDER[0])

    def _tree(self, wider: float) -> Tree:
        if wider not in self._trees:
            self._trees[wider] = Tree(self._start, self._ground(self._start[None], wider))
        return self._trees[wider]

    def _ground(self, ends: Array, wider: float) -> MotionValidator:
        return MotionValidator(self._robot, self._space, self._exact, ends, wider)


def _paths(ground: MotionValidator, corners: Array) -> Iterator[Array]:
    """Paths along corners, best first; whether they are clear is not known yet."""
    short = _shortened(ground, corners)
    path = ground.fine(short)
    if path is not None:
        rounded = _rounded(ground, path)
        if rounded is not None:
            yield rounded
        yield path
    if len(short) < len(corners):
        path = ground.fine(corners)
        if path is not None:
            yield path


def _shortened(ground: MotionValidator, corners: Array) -> Array:
    """Leave out corners where the straight path is clear."""
    first = 0
    while first < len(corners) - 2:
        later = corners[first + 2 :]
        passes = np.flatnonzero(ground.straight(np.broadcast_to(corners[first], later.shape), later))
        if len(passes):
            corners = np.concatenate([corners[: first + 1], corners[first + 2 + passes[-1] :]])
        first += 1
    return corners


def _rounded(ground: MotionValidator, path: Array) -> Array | None:
    """The path with its corners rounded, since a robot would have to crawl round them; None if a joint jumps then."""
    window = min(ROUNDED, 2 * ((len(path) - 1) // 2) + 1)
    half = window // 2
    free = path[:, ground.space.free]
    # mirrored about either end, so that the ends stay where they are
    before, after = 2.0 * free[0] - free[half:0:-1], 2.0 * free[-1] - free[-2 : -half - 2 : -1]
    padded = np.concatenate([before, free, after])
    smooth = np.column_stack(
        [np.convolve(column, np.full(window, 1.0 / window), "valid") for column in padded.T]
    )
    rounded = ground.space.placed(smooth, path)
    rounded[[0, -1]] = path[[0, -1]]
    return rounded if np.isfinite(rounded).all() and ground.is_steady(rounded) else None
