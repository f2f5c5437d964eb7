"""Collision-free paths from one configuration to others, with the hands fixed or not.

They are straight in the free joints where that is clear; otherwise two trees grow towards each other. The tree about
the start is kept, so that the path to one goal helps to find that to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.motion_validator import FINE, FINE_SHARE, LEAP, MARGIN_M, MotionValidator
from deltaq_controllers.advisor.space import Space
from deltaq_controllers.advisor.trees import Tree, connected
from deltaq_protocol.arrays import Array

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
    """A way along which the tightest pair parts, by the steepest ascent of its room.

    Args:
        robot: its joint limits are kept.
        space: in which the way lies.
        exact: measures.
        start: (n,) where it begins, in the space.
        enough_m: room at which it ends.

    Returns:
        (P, n) configurations, `start` first, neighbours no further apart than `FINE` in the free joints. It ends
        earlier where no joint parts the bodies any more; with `start` alone if there is room, or no way to any.
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


ROUNDS = 30
"""How often a tree is grown in search of one path."""
CHECKED = 2
"""Of so many configurations of a path one is measured exactly; the gate measures every one that is driven."""
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
        space: in which to look.
        exact: measures the paths that are returned.
        generator: of random numbers.
        start: (n,) where they begin, in the space.
    """

    def __init__(
        self,
        robot: RobotModel,
        space: Space,
        exact: ExactClearance,
        generator: np.random.Generator,
        start: Array,
    ) -> None:
        self._robot, self._space, self._exact, self._generator = robot, space, exact, generator
        self._way_out = parted(robot, space, exact, start, FINE_SHARE * MARGIN_M)
        self._start = self._way_out[-1]
        self._limits = robot.lower[space.free], robot.upper[space.free]
        self._trees: dict[float, Tree] = {}

    def to(self, goal: Array, go_on: Callable[[], bool] = lambda: True) -> Array:
        """A path to a configuration.

        Args:
            goal: (n,) in the space.
            go_on: asked now and then.

        Returns:
            (P, n) configurations, neighbours no further apart than `FINE` in the free joints. Where the robot stands
            close to a body, they begin with a way away from it.

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
            corners = connected(self._tree(wider), goal, ground, self._limits, self._generator, ROUNDS, go_on)
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
