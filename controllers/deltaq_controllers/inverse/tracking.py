"""Constraint tracking: the joints of the arms follow from those of the base, so that the hands stay where they are.

Hooper and Noakes, III-B, `n-6_nT = 0_(n-6)T^-1 0_nT` (printed with n-5, see the errata): with the hands' poses given
only the joints outside six of each chain are free, as a rule those before the last six. A DAWM keeps 5 of 17, a KR 16
on a gantry 3 of 9, a Panda 1 of 7.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.batch import BatchKinematics
from deltaq_controllers.inverse.any_arm import HAS_CLOSED_FORMS, AnyArm
from deltaq_controllers.inverse.arms import ARM_JOINTS, Arm, TrackingError, arm_of, inverted
from deltaq_controllers.inverse.branches import Branches
from deltaq_protocol.arrays import Array

__all__ = ["ARM_JOINTS", "Arm", "ConstraintTracker", "TrackingError"]


class ConstraintTracker:
    """Splits a robot into arms with an inverse and a base that is free.

    Args:
        robot: its model.

    Attributes:
        robot: as given.
        kinematics: of many configurations at once.
        arms: one a hand, in the order of the robot's hands.
        base: indices of the joints that are free.

    Raises:
        TrackingError: a hand is carried by fewer than six joints, one of its arm slides, or arms share joints.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self.kinematics = BatchKinematics(robot)
        self.arms = tuple(arm_of(robot, self.kinematics, hand) for hand in robot.hands)
        taken = {int(joint) for arm in self.arms for joint in arm.joints}
        if len(taken) < ARM_JOINTS * len(self.arms):
            raise TrackingError(f"robot '{robot.name}': the arms of {', '.join(robot.hands)} share joints")
        self.base = np.array([joint for joint in range(robot.n) if joint not in taken], dtype=np.intp)
        beyond = {joint for arm in self.arms for joint in arm.beyond}
        self._before = [joint for joint in self.base.tolist() if joint not in beyond]

    @property
    def word(self) -> str:
        """Which arms have no closed form, and what helps; empty if all have one."""
        numeric = [arm.hand for arm in self.arms if isinstance(arm.solver, AnyArm) and not arm.solver.family]
        if not numeric:
            return ""
        remedy = "" if HAS_CLOSED_FORMS else "; most arms have one with `pip install 'deltaq[arms]'`"
        arms, have, are = ("arms", "have", "are") if len(numeric) > 1 else ("arm", "has", "is")
        return (
            f"the {arms} of {' and '.join(numeric)} {have} no closed form here and {are} solved numerically: "
            f"some branches may be missed, and answers take longer{remedy}"
        )

    def hands(self, q: Array) -> Array:
        """(h, 4, 4) poses of all hands at the configuration `q` (n,), in the world."""
        return np.stack([self.robot.forward(q, hand) for hand in self.robot.hands])

    def solve(self, base: Array, T_world_hands: Array, hint: Array | None = None) -> list[Branches]:
        """All branches of every arm.

        Args:
            base: (N, m) values of the base joints.
            T_world_hands: (h, 4, 4) where the hands should be.
            hint: (n,) configuration whose values count for joints that the poses leave free.

        Returns:
            Of each arm its branches.
        """
        return [
            arm.solver.inverse(poses, None if hint is None else hint[arm.joints])
            for arm, poses in self._poses(base, T_world_hands)
        ]

    def track(self, base: Array, T_world_hands: Array, reference: Array) -> Array:
        """Configurations with the hands kept, each arm on the branch nearest to a reference.

        Args:
            base: (N, m) values of the base joints.
            T_world_hands: (h, 4, 4) where the hands should be.
            reference: (n,) or (N, n) configuration to be near to.

        Returns:
            (N, n) configurations inside the joint limits; NaN where an arm cannot reach.
        """
        reference = np.broadcast_to(reference, (len(base), self.robot.n))
        q = np.empty((len(base), self.robot.n))
        q[:, self.base] = base
        for arm, poses in self._poses(base, T_world_hands):
            lower, upper = self.robot.lower[arm.joints], self.robot.upper[arm.joints]
            q[:, arm.joints] = arm.solver.near(poses, reference[:, arm.joints], lower, upper)
        within = (base >= self.robot.lower[self.base]) & (base <= self.robot.upper[self.base])
        q[~(np.isfinite(q).all(axis=1) & within.all(axis=1))] = np.nan
        return q

    def walk(self, origin: Array, target: Array, T_world_hands: Array, pieces: int) -> Array:
        """Paths that are straight in the base, the hands kept, each arm following without a change of branch.

        Limits are not checked.

        Args:
            origin: (N, n) configurations with the hands in place.
            target: (N, m) values of the base joints at the paths' ends.
            T_world_hands: (h, 4, 4) where the hands should be.
            pieces: into how many equal pieces each path is divided.

        Returns:
            (N, pieces + 1, n) configurations from each origin on; NaN from where an arm cannot reach.
        """
        count = len(origin)
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        base = origin[:, None, self.base] + shares * (target - origin[:, self.base])[:, None]
        way = np.empty((count, pieces + 1, self.robot.n))
        way[:, 0], way[:, 1:, self.base] = origin, base[:, 1:]
        for arm, poses in self._poses(base.reshape(-1, len(self.base)), T_world_hands):
            followed = arm.solver.follow(poses.reshape(count, pieces + 1, 4, 4), origin[:, arm.joints])
            way[:, 1:, arm.joints] = followed[:, 1:]
        way[:, 1:][~np.isfinite(way[:, 1:]).all(axis=2)] = np.nan
        return way

    def branch(self, q: Array, T_world_hands: Array) -> tuple[int, ...]:
        """Which branch each arm is on at `q` (n,); it changes at singularities only."""
        return tuple(
            arm.solver.branch(pose, q[arm.joints])
            for arm, (pose,) in self._poses(q[None, self.base], T_world_hands)
        )

    def _poses(self, base: Array, T_world_hands: Array) -> Iterator[tuple[Arm, Array]]:
        """Of each arm the poses (N, 4, 4) in its base frame that its inverse is asked for."""
        q = np.zeros((len(base), self.robot.n))
        q[:, self.base] = base
        frames = self.kinematics.frames(q, self._before)
        for arm, T_world_hand in zip(self.arms, T_world_hands, strict=True):
            T_world_base = self.kinematics.mounts(frames, int(arm.joints[0]), len(base)) @ arm.T_mount_base
            T_base_hand = inverted(T_world_base) @ T_world_hand
            yield arm, T_base_hand @ arm.pose_of_last(self.kinematics, q) if arm.beyond else T_base_hand
