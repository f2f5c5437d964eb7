"""Where a path may pass (motion validity): clear of obstacles and limits, and without a jump of any joint."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.space import Space
from deltaq_protocol.arrays import Array, Flags

STEP = 0.05
"""Distance in the free joints between two configurations that are checked while searching [rad or m]."""
FINE = 0.01
"""Distance in the free joints between two configurations of a returned path [rad or m]."""
FINER = (1, 4, 16)
"""Into so many times the pieces a straight path is divided until no joint jumps: an arm is quick near a singularity."""
LEAP = 4.0
"""Any joint may change by this many times the step; more is another branch, or too near to a singularity."""
SEARCHED_LEAP = 3.0
"""The same while searching, so that the finer check agrees."""
MARGIN_M = 0.015
"""Margin to bodies that the search keeps where start and goal have it, so that the finer check agrees."""
LIMIT_MARGIN = 0.05
"""Margin to joint limits that a path keeps where start and goal have it, so that it can be braked [rad or m]."""
LIMIT_SHARE = 0.02
"""The same as a fraction of the joint's range; the greater of the two counts."""
FINE_SHARE = 0.4
"""Fraction of the margins that is kept between the configurations that the search looked at."""
SAMPLED = 6
"""Of so many configurations of a path one is looked at first: most blocked paths are blocked over a good part."""


class MotionValidator:
    """Where paths between some configurations may pass.

    Args:
        robot: the robot, whose limits are kept.
        space: in which the paths lie.
        exact: measures the distances of bodies.
        ends: (k, n) configurations that paths begin and end at; margins are no larger than these have them.
        wider: factor of the usual margin to bodies.

    Attributes:
        space: as given.
        margin_m: margin to bodies that is kept.
    """

    def __init__(
        self, robot: RobotModel, space: Space, exact: ExactClearance, ends: Array, wider: float
    ) -> None:
        self.space, self._exact = space, exact
        room_m = min(exact.measure(q).room_m for q in ends)
        self.margin_m = float(np.clip(0.8 * room_m, 0.0, wider * MARGIN_M))
        self._limits = robot.lower, robot.upper
        self._margin = np.maximum(LIMIT_MARGIN, LIMIT_SHARE * (robot.upper - robot.lower))
        self._lowest, self._highest = ends.min(axis=0), ends.max(axis=0)

    def within(self, q: Array, share: float = 1.0) -> Flags:
        """(...) whether configurations (..., n) keep a fraction of the margin to the limits."""
        lower, upper = self._limits
        low = np.minimum(lower + share * self._margin, self._lowest)
        high = np.maximum(upper - share * self._margin, self._highest)
        within: Flags = np.all((q >= low) & (q <= high), axis=-1)
        return within

    def clear(self, q: Array) -> Flags:
        """(N,) whether configurations (N, n) keep the margins to bodies and limits."""
        clear = self.within(q)
        inside = np.flatnonzero(clear)
        if len(inside):
            clear[inside] = self._exact.kept(q[inside], self.margin_m)
        return clear

    def walk(self, origin: Array, target: Array) -> tuple[Array, Flags]:
        """Paths that are straight in the free joints.

        Args:
            origin: (N, n) where they begin.
            target: (N, m) free joints where they end.

        Returns:
            (N, P + 1, n) configurations, and (N,) whether each path is inside the limits and without a jump.
        """
        change = float(np.abs(target - origin[:, self.space.free]).max(initial=0.0))
        way = self.space.walk(origin, target, max(1, int(np.ceil(change / STEP))))
        steady = np.abs(np.diff(way, axis=1)).max(axis=2) <= SEARCHED_LEAP * STEP
        return way, (steady & self.within(way[:, 1:])).all(axis=1)

    def straight(self, origin: Array, target: Array) -> Flags:
        """(N,) whether configurations (N, n) can be reached from others (N, n) straight in the free joints."""
        way, passes = self.walk(origin, target[:, self.space.free])
        passes &= np.abs(way[:, -1] - target).max(axis=1) < 1e-6
        between = np.arange(1, way.shape[1])
        for looked_at in (between[between % SAMPLED == 0], between[between % SAMPLED != 0]):
            rows = np.flatnonzero(passes)
            if len(rows) and len(looked_at):
                seen = self.clear(way[rows][:, looked_at].reshape(-1, way.shape[2]))
                passes[rows] = seen.reshape(len(rows), -1).all(axis=1)
        return passes

    def fine(self, corners: Array) -> Array | None:
        """(P, n) the path from corner to corner (k, n) as it is returned; None if a joint jumps."""
        legs = [corners[:1]]
        for start, corner in zip(corners[:-1], corners[1:, self.space.free], strict=True):
            change = np.abs(corner - start[self.space.free]).max()
            pieces = max(1, int(np.ceil(change / FINE)))
            for finer in FINER:
                (leg,) = self.space.walk(start[None], corner[None], finer * pieces)
                if self.is_steady(leg):
                    break
            legs.append(leg[1:])
        path = np.concatenate(legs)
        return path if self.is_steady(path) and np.abs(path[-1] - corners[-1]).max() < 1e-6 else None

    def is_steady(self, path: Array) -> bool:
        """Whether no joint jumps along a path (P, n) that is to be returned."""
        return bool((np.abs(np.diff(path, axis=0)).max(axis=1) <= LEAP * FINE).all())
