"""The spaces in which paths are searched for: with the hands fixed, or with all joints free."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_protocol.arrays import Array


class Space(Protocol):
    """Configurations that follow from some of their joints.

    Attributes:
        free: (m,) indices of the joints that the others follow from.
    """

    free: NDArray[np.intp]

    def walk(self, origin: Array, target: Array, pieces: int) -> Array:
        """(N, pieces + 1, n) paths from configurations (N, n), straight to (N, m); NaN from where there is none."""
        ...

    def placed(self, free: Array, near: Array) -> Array:
        """(N, n) configurations with the free joints (N, m), each on the branch that (N, n) are on; NaN for none."""
        ...

    def barred(self, start: Array, goal: Array) -> str:
        """Why no path can lead from one configuration (n,) to another; empty if one may."""
        ...


class HandsKept:
    """Self-motions: the base is free, and the arms keep the hands where they are.

    Args:
        tracker: of the robot.
        T_world_hands: (h, 4, 4) where the hands are kept.
    """

    def __init__(self, tracker: ConstraintTracker, T_world_hands: Array) -> None:
        self._tracker, self._poses = tracker, T_world_hands
        self.free = tracker.base

    def walk(self, origin: Array, target: Array, pieces: int) -> Array:
        """Straight in the base, the arms following on their branches."""
        return self._tracker.walk(origin, target, self._poses, pieces)

    def placed(self, free: Array, near: Array) -> Array:
        """The arms on the branches nearest to `near`."""
        return self._tracker.track(free, self._poses, near)

    def barred(self, start: Array, goal: Array) -> str:
        """An arm that is on another branch at the goal: between branches lie singularities."""
        branches = zip(
            self._tracker.arms,
            self._tracker.branch(start, self._poses),
            self._tracker.branch(goal, self._poses),
            strict=True,
        )
        hands = [arm.hand for arm, here, there in branches if here != there]
        if not hands:
            return ""
        names = " and ".join(hands)
        arms, are = ("arms", "are") if len(hands) > 1 else ("arm", "is")
        return f"the {arms} of {names} {are} on another branch, beyond a singularity"


class HandsMoved:
    """All joints free, the hands wherever that takes them."""

    def __init__(self, robot: RobotModel) -> None:
        self.free = np.arange(robot.n)

    def walk(self, origin: Array, target: Array, pieces: int) -> Array:
        """Straight in the joints."""
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        way: Array = origin[:, None] + shares * (target - origin)[:, None]
        return way

    def placed(self, free: Array, _near: Array) -> Array:
        """The joints as given."""
        return free

    def barred(self, _start: Array, _goal: Array) -> str:
        """No reason: every configuration may be connected."""
        return ""
