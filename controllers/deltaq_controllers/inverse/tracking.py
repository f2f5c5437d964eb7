"""Constraint tracking: the joints of the arms follow from those of the base, so that the hands stay where they are.

Hooper and Noakes, III-B, `n-6_nT = 0_(n-6)T^-1 0_nT` (printed with n-5, see the errata): with the hands' poses given
only the joints before the last six of each chain are free. A DAWM keeps 5 of 17, a KR 16 on a gantry 3 of 9.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.robot import RobotModel
from deltaq_controllers.batch import BatchKinematics
from deltaq_controllers.inverse.branches import Branches, wrapped
from deltaq_controllers.inverse.kr16 import SHOULDER_HEIGHT, T_WRIST_FLANGE, Kr16Inverse
from deltaq_controllers.inverse.titan import TitanInverse, TitanLengths
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

ARM_JOINTS = 6


class TrackingError(DeltaqError):
    """A robot whose arms no closed form fits."""


class ArmInverse(Protocol):
    """A closed form: all branches for poses of the tool in the arm's base frame."""

    def inverse(self, poses: Array, hint: Array | None = None) -> Branches:
        """All configurations that put the tool at each pose."""
        ...


@dataclass(frozen=True)
class Arm:
    """The last six joints before a hand.

    Attributes:
        hand: its name.
        joints: (6,) their indices.
        solver: their closed form.
        T_mount_base: (4, 4) the closed form's base frame in the frame of the first joint at zero.
    """

    hand: str
    joints: NDArray[np.intp]
    solver: ArmInverse
    T_mount_base: Array


class ConstraintTracker:
    """Splits a robot into arms with a closed form and a base that is free.

    Args:
        robot: its model.

    Attributes:
        robot: as given.
        kinematics: of many configurations at once.
        arms: one a hand, in the order of the robot's hands.
        base: indices of the joints that are free.

    Raises:
        TrackingError: a hand's last six joints are of no arm with a closed form.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self.kinematics = BatchKinematics(robot)
        self.arms = tuple(self._arm(hand) for hand in robot.hands)
        taken = {int(joint) for arm in self.arms for joint in arm.joints}
        if len(taken) < ARM_JOINTS * len(self.arms):
            raise TrackingError(f"robot '{robot.name}': the arms of {', '.join(robot.hands)} share joints")
        self.base = np.array([joint for joint in range(robot.n) if joint not in taken], dtype=np.intp)
        self._base_list = self.base.tolist()

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
        q = np.zeros((len(base), self.robot.n))
        q[:, self.base] = base
        frames = self.kinematics.frames(q, self._base_list)
        solutions = []
        for arm, T_world_hand in zip(self.arms, T_world_hands, strict=True):
            T_world_base = self.kinematics.mounts(frames, int(arm.joints[0]), len(base)) @ arm.T_mount_base
            T_base_hand = _inverted(T_world_base) @ T_world_hand
            solutions.append(arm.solver.inverse(T_base_hand, None if hint is None else hint[arm.joints]))
        return solutions

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
        hint = reference[0] if len(base) else None
        for arm, branches in zip(self.arms, self.solve(base, T_world_hands, hint), strict=True):
            lower, upper = self.robot.lower[arm.joints], self.robot.upper[arm.joints]
            near = reference[:, None, arm.joints]
            fitted, inside = branches.fitted(near, lower, upper)
            distance = np.where(inside, np.abs(fitted - near).max(axis=2), np.inf)
            best = distance.argmin(axis=1)
            rows = np.arange(len(base))
            q[:, arm.joints] = np.where(inside[rows, best, None], fitted[rows, best], np.nan)
        within = (base >= self.robot.lower[self.base]) & (base <= self.robot.upper[self.base])
        q[~(np.isfinite(q).all(axis=1) & within.all(axis=1))] = np.nan
        return q

    def walk(self, origin: Array, target: Array, T_world_hands: Array, pieces: int) -> Array:
        """Paths that are straight in the base, the hands kept, each arm following without a change of branch.

        All branches of all configurations are solved at once, and each arm keeps its own. Limits are not checked.

        Args:
            origin: (N, n) configurations with the hands in place.
            target: (N, m) values of the base joints at the paths' ends.
            T_world_hands: (h, 4, 4) where the hands should be.
            pieces: into how many equal pieces each path is divided.

        Returns:
            (N, pieces + 1, n) configurations from each origin on; NaN from where an arm cannot reach.
        """
        count, rows = len(origin), np.arange(len(origin))
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        base = origin[:, None, self.base] + shares * (target - origin[:, self.base])[:, None]
        way = np.empty((count, pieces + 1, self.robot.n))
        way[:, 0], way[:, 1:, self.base] = origin, base[:, 1:]
        hint = origin[0] if count else None
        solved = self.solve(base.reshape(-1, len(self.base)), T_world_hands, hint)
        for arm, branches in zip(self.arms, solved, strict=True):
            q = np.where(branches.exists[:, :, None], branches.q, np.nan)
            q = q.reshape(count, pieces + 1, 8, ARM_JOINTS)
            # two branches touch in a singularity, where the nearest one may be the other
            branch = _largest(wrapped(q[:, 0] - origin[:, None, arm.joints])).argmin(axis=1)
            followed = q[rows, :, branch]
            steps = wrapped(np.diff(followed, axis=1))
            way[:, 1:, arm.joints] = origin[:, None, arm.joints] + np.cumsum(steps, axis=1)
        way[:, 1:][~np.isfinite(way[:, 1:]).all(axis=2)] = np.nan
        return way

    def branch(self, q: Array, T_world_hands: Array) -> tuple[int, ...]:
        """Which branch each arm is on at `q` (n,); it changes at singularities only."""
        branches = self.solve(q[None, self.base], T_world_hands, q)
        return tuple(
            int(_largest(wrapped(found.q[0] - q[arm.joints])).argmin())
            for arm, found in zip(self.arms, branches, strict=True)
        )

    def _arm(self, hand: str) -> Arm:
        model = self.robot.model
        frame = model.frames[self.robot.frame_of(hand)]
        chain = [joint - 1 for joint in model.supports[int(frame.parentJoint)] if joint > 0]
        joints = np.array(chain[-ARM_JOINTS:], dtype=np.intp)
        if len(joints) == ARM_JOINTS:
            for arm in self._candidates(hand, joints, frame.placement.homogeneous):
                if self._fits(arm):
                    return arm
        raise TrackingError(
            f"robot '{self.robot.name}': no closed form is known for the last six joints of {hand}; "
            "there is one for the KUKA KR 16 and one for the Schilling Titan II"
        )

    def _candidates(self, hand: str, joints: NDArray[np.intp], T_last_tool: Array) -> list[Arm]:
        places = [self.robot.model.jointPlacements[int(joint) + 1].translation for joint in joints]
        azimuth, upper_arm, forearm, wrist = (float(place[2]) for place in places[1:5])
        lengths = TitanLengths(azimuth, upper_arm, forearm, wrist, tool=0.0)
        below = np.eye(4)
        below[2, 3] = -SHOULDER_HEIGHT
        T_flange_tool = np.linalg.inv(T_WRIST_FLANGE) @ T_last_tool
        candidates = [Arm(hand, joints, Kr16Inverse(T_flange_tool), below)]
        if lengths.upper_arm > 0.0 and lengths.forearm > 0.0:
            candidates.insert(0, Arm(hand, joints, TitanInverse(lengths, T_last_tool), np.eye(4)))
        return candidates

    def _fits(self, arm: Arm) -> bool:
        """Whether the closed form reproduces a configuration of the model itself."""
        q = self.robot.lower + (self.robot.upper - self.robot.lower) * np.linspace(0.37, 0.61, self.robot.n)
        frames = self.kinematics.frames(q[None])
        mount = self.kinematics.mounts(frames, int(arm.joints[0]), 1)[0] @ arm.T_mount_base
        branches = arm.solver.inverse(np.linalg.inv(mount) @ self.robot.forward(q, arm.hand), q[arm.joints])
        difference = np.abs(np.angle(np.exp(1j * (branches.q - q[arm.joints])))).max(axis=1)
        return bool((difference[branches.exists] < 1e-6).any())


def _largest(changes: Array) -> Array:
    """(...) largest change of a joint, of changes (..., 6); infinite where there is none."""
    largest: Array = np.abs(changes).max(axis=-1)
    return np.where(np.isfinite(largest), largest, np.inf)


def _inverted(T: Array) -> Array:
    """Inverse of poses (N, 4, 4)."""
    inverse = np.zeros_like(T)
    inverse[:, :3, :3] = T[:, :3, :3].transpose(0, 2, 1)
    inverse[:, :3, 3] = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    inverse[:, 3, 3] = 1.0
    return inverse
