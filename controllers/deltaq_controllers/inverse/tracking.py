"""Constraint tracking: computes the arms' joints from the base joints, so that the hands stay in place.

Hooper and Noakes, III-B, `n-6_nT = 0_(n-6)T^-1 0_nT` (printed with n-5, see the errata): with the hands' poses given
only the joints outside six of each chain are free, as a rule those before the last six. A DAWM keeps 5 of 17, a KR 16
on a gantry 3 of 9, a Panda 1 of 7.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.batch import BatchKinematics
from deltaq_controllers.inverse.any_arm import HAS_CLOSED_FORMS, AnyArm
from deltaq_controllers.inverse.branches import Branches, wrapped
from deltaq_controllers.inverse.chain import Chain, chain_of
from deltaq_controllers.inverse.kr16 import SHOULDER_HEIGHT, T_WRIST_FLANGE, Kr16Inverse
from deltaq_controllers.inverse.titan import TitanInverse, TitanLengths
from deltaq_controllers.task import NO_TASK, Task, tolerant, tolerated
from deltaq_protocol.arrays import Array, Indices
from deltaq_protocol.errors import DeltaqError

# The arm before a hand: which six joints, and the inverse that fits them.


ARM_JOINTS = 6


class TrackingError(DeltaqError):
    """A robot with an arm that has no inverse."""


class ArmInverse(Protocol):
    """The inverse of six joints in a row, for poses of the tool in the arm's base frame."""

    def inverse(self, poses: Array, hint: Array | None = None) -> Branches:
        """All configurations that put the tool at each pose."""
        ...

    def near(self, poses: Array, reference: Array, lower: Array, upper: Array) -> Array:
        """(N, 6) solution inside the limits that is nearest to a reference (N, 6); NaN where there is none."""
        ...

    def follow(self, poses: Array, start: Array) -> Array:
        """(N, P, 6) configurations along paths (N, P, 4, 4) from (N, 6) on, without a change of branch."""
        ...

    def branch(self, pose: Array, q: Array) -> int:
        """Number of the branch that `q` (6,) is on, which puts the tool at a pose (4, 4)."""
        ...


@dataclass(frozen=True)
class Arm:
    """Six joints in a row before a hand.

    Attributes:
        hand: its name.
        joints: (6,) their indices.
        solver: their inverse, of the hand or, if there are joints beyond, of the last joint's frame.
        T_mount_base: (4, 4) the inverse's base frame in the frame of the first joint at zero.
        beyond: indices of the joints between arm and hand, tolerances included.
        T_last_hand: (4, 4) the hand in the frame of the last joint before it.
    """

    hand: str
    joints: Indices
    solver: ArmInverse
    T_mount_base: Array = field(default_factory=lambda: np.eye(4))
    beyond: tuple[int, ...] = ()
    T_last_hand: Array = field(default_factory=lambda: np.eye(4))

    def chain(self, robot: RobotModel) -> Chain:
        """The arm's joints at zero, with the tool frame of its inverse."""
        return chain_of(robot.model, self.joints, np.eye(4) if self.beyond else self.T_last_hand)

    def pose_of_last(self, kinematics: BatchKinematics, q: Array) -> Array:
        """(N, 4, 4) frame of the arm's last joint in that of the hand, at configurations (N, n)."""
        frames = kinematics.frames(q, list(self.beyond), carrier=int(self.joints[-1]))
        T = np.zeros((len(q), 4, 4))
        T[:, :3, :3], T[:, :3, 3] = frames.rotation[self.beyond[-1]], frames.position[self.beyond[-1]]
        T[:, 3, 3] = 1.0
        return inverted(T @ self.T_last_hand)


def arm_of(robot: RobotModel, kinematics: BatchKinematics, hand: str, driven: int) -> Arm:
    """The arm before a hand.

    It is the last six joints where these have an inverse in closed form: the KR 16's or the Titan II's own, which are
    the quickest, or one that EAIK finds. A longer chain may have one for six joints further in only, as a Panda has,
    whose last joint is free then. Otherwise the last six are solved by Newton's method.

    Args:
        robot: its model.
        kinematics: of the same.
        hand: name of the hand.
        driven: number of joints with a drive; those after them are tolerances.

    Raises:
        TrackingError: fewer than six joints carry the hand, or one of the six slides.
    """
    frame = robot.model.frames[robot.frame_of(hand)]
    T_last_hand = frame.placement.homogeneous
    whole = np.array([joint - 1 for joint in robot.model.supports[int(frame.parentJoint)] if joint > 0])
    chain, loose = whole[whole < driven], whole[whole >= driven]
    last = chain[-ARM_JOINTS:]
    if len(last) < ARM_JOINTS:
        raise TrackingError(
            f"robot '{robot.name}': {hand} is carried by {len(last)} joint{'s' * (len(last) != 1)}, and an arm has "
            f"{ARM_JOINTS}"
        )
    for arm in _of_our_own(robot, hand, last, loose, T_last_hand):
        if _fits(robot, kinematics, arm):
            return arm
    if not robot.revolute[last].all():
        sliding = ", ".join(np.array(robot.joint_names)[last][~robot.revolute[last]])
        raise TrackingError(
            f"robot '{robot.name}': {sliding} is prismatic; the six joints before {hand} must be revolute"
        )
    for arm in _in_closed_form(robot, hand, chain, loose, T_last_hand):
        if _fits(robot, kinematics, arm):
            return arm
    limits = robot.lower[last], robot.upper[last]
    T_last_tool = np.eye(4) if len(loose) else T_last_hand
    numeric = AnyArm(chain_of(robot.model, last, T_last_tool), *limits, numeric=True)
    return Arm(hand, last, numeric, beyond=tuple(loose.tolist()), T_last_hand=T_last_hand)


def _of_our_own(
    robot: RobotModel, hand: str, joints: Indices, loose: Indices, T_last_hand: Array
) -> Iterator[Arm]:
    T_last_tool, beyond = np.eye(4) if len(loose) else T_last_hand, tuple(loose.tolist())
    places = [robot.model.jointPlacements[int(joint) + 1].translation for joint in joints]
    azimuth, upper_arm, forearm, wrist = (float(place[2]) for place in places[1:5])
    if upper_arm > 0.0 and forearm > 0.0:
        lengths = TitanLengths(azimuth, upper_arm, forearm, wrist, tool=0.0)
        yield Arm(hand, joints, TitanInverse(lengths, T_last_tool), beyond=beyond, T_last_hand=T_last_hand)
    below = np.eye(4)
    below[2, 3] = -SHOULDER_HEIGHT
    kr16 = Kr16Inverse(np.linalg.inv(T_WRIST_FLANGE) @ T_last_tool)
    yield Arm(hand, joints, kr16, below, beyond, T_last_hand)


def _in_closed_form(
    robot: RobotModel, hand: str, chain: Indices, loose: Indices, T_last_hand: Array
) -> Iterator[Arm]:
    """Arms of six joints in a row that EAIK can decompose, the outermost first."""
    for first in range(len(chain) - ARM_JOINTS, -1, -1):
        joints, beyond = chain[first : first + ARM_JOINTS], np.append(chain[first + ARM_JOINTS :], loose)
        if not robot.revolute[joints].all():
            return
        T_last_tool = np.eye(4) if len(beyond) else T_last_hand
        links = chain_of(robot.model, joints, T_last_tool)
        solver = AnyArm(links, robot.lower[joints], robot.upper[joints])
        if solver.family:
            yield Arm(hand, joints, solver, beyond=tuple(beyond.tolist()), T_last_hand=T_last_hand)


def _fits(robot: RobotModel, kinematics: BatchKinematics, arm: Arm) -> bool:
    """Whether the inverse reproduces a configuration of the model itself."""
    q = robot.lower + (robot.upper - robot.lower) * np.linspace(0.37, 0.61, robot.n)
    frames = kinematics.frames(q[None])
    T_base_world = np.linalg.inv(kinematics.mounts(frames, int(arm.joints[0]), 1)[0] @ arm.T_mount_base)
    pose = T_base_world @ robot.forward(q, arm.hand)
    if arm.beyond:
        pose = pose @ arm.pose_of_last(kinematics, q[None])[0]
    branches = arm.solver.inverse(pose, q[arm.joints])
    difference = np.abs(wrapped(branches.q - q[arm.joints])).max(axis=1)
    return bool((difference[branches.exists] < 1e-6).any())


def inverted(T: Array) -> Array:
    """Inverse of poses (N, 4, 4)."""
    inverse = np.zeros_like(T)
    inverse[:, :3, :3] = T[:, :3, :3].transpose(0, 2, 1)
    inverse[:, :3, 3] = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    inverse[:, 3, 3] = 1.0
    return inverse


__all__ = ["ARM_JOINTS", "Arm", "ConstraintTracker", "TrackingError"]


class ConstraintTracker:
    """Splits a robot into arms with an inverse and a base that is free.

    Tolerances of a task are free joints. Configurations contain them, after the robot's own joints.

    Args:
        robot: its model.
        task: names the tolerances.

    Attributes:
        own: the robot, as given.
        driven: number of its joints.
        robot: the same with a joint for each tolerance.
        task: as given.
        kinematics: of many configurations at once.
        arms: one a hand, in the order of the robot's hands.
        base: indices of the joints that are free.

    Raises:
        TrackingError: a hand is carried by fewer than six joints, one of its arm slides, or arms share joints.
        TaskError: the robot does not have a hand that the task names.
    """

    def __init__(self, robot: RobotModel, task: Task = NO_TASK) -> None:
        self.own, self.driven, self.task = robot, robot.n, task
        self.robot = robot = tolerant(robot, task)
        self.kinematics = BatchKinematics(robot)
        self.arms = tuple(arm_of(robot, self.kinematics, hand, self.driven) for hand in robot.hands)
        taken = {int(joint) for arm in self.arms for joint in arm.joints}
        if len(taken) < ARM_JOINTS * len(self.arms):
            raise TrackingError(f"robot '{robot.name}': the arms of {', '.join(robot.hands)} share joints")
        self.base = np.array([joint for joint in range(robot.n) if joint not in taken], dtype=np.intp)
        beyond = {joint for arm in self.arms for joint in arm.beyond}
        self._before = [joint for joint in self.base.tolist() if joint not in beyond]

    @property
    def word(self) -> str:
        """Names the arms without a closed form, and the remedy; empty if all have one."""
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
        """(h, 4, 4) places of all hands at the configuration `q` (n,), in the world; missing tolerances are zero."""
        q = np.append(q, np.zeros(self.robot.n - len(q)))
        return np.stack([self.robot.forward(q, hand) for hand in self.robot.hands])

    def with_tolerances(self, q: Array, T_world_hands: Array) -> Array:
        """The configuration of the robot's own joints (n,) with the tolerances that have the hands at their places.

        Args:
            q: own joints; any more are replaced.
            T_world_hands: (h, 4, 4) where the hands should be. What no tolerance allows is left out.
        """
        q = q[: self.driven]
        if self.driven == self.robot.n:
            return q
        places = zip(self.robot.hands, inverted(self.hands(q)) @ T_world_hands, strict=True)
        off = {hand: tolerated(self.task, hand, T) for hand, T in places}
        return np.concatenate([q, *(off[hand] for hand in self.task.hands)])

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


# Which robot of a cell has joints to spare.


def first_redundant(
    robots: Mapping[str, RobotModel], most_hands: int | None = None
) -> ConstraintTracker | None:
    """The inverse of the first redundant robot of a cell; None if there is none.

    Args:
        robots: of the cell, by name.
        most_hands: it may have; None for any number.
    """
    for robot in robots.values():
        if most_hands is not None and len(robot.hands) > most_hands:
            continue
        try:
            tracker = ConstraintTracker(robot)
        except TrackingError:
            continue
        if len(tracker.base):
            return tracker
    return None
