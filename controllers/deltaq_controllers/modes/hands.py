"""A robot's hands: poses, Jacobians, and the joints that carry each."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.kinematics import JointTree, joint_tree, joints_that_move, placed_joints
from deltaq_controllers.modes.conditioning import LENGTH_M
from deltaq_controllers.vectors import turn_between
from deltaq_protocol.arrays import Array, Indices

ARM_JOINTS = 6
"""Joints next to a hand that make up its arm."""


class Hands:
    """The hands (end effectors) of one robot.

    Args:
        robot: the robot.

    Attributes:
        names: of the hands; `tool` for the only one.
        moved_by: (h, n) whether joint j moves hand i.
        units: (6 h,) what a displacement of the hands counts as travel: 1, and `LENGTH_M` for turns [m/m, m/rad].
        arms: (h, n) whether joint j is one of the six next to hand i, and moves no other.
        rotations: (h, 3, 3) axes of each hand in the world, after `update`.
        positions: (h, 3) origin of each hand in the world [m].
        jacobian: (6 h, n) of the hands one under the other, linear over angular rows, world axes.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.names = robot.hands
        self.units = np.tile(np.repeat([1.0, LENGTH_M], 3), len(robot.hands))
        self._links = links_of(robot)
        self.moved_by = self._links.moved_by
        self.arms = np.zeros_like(self.moved_by)
        for arm, moves in zip(self.arms, self.moved_by, strict=True):
            own = np.flatnonzero(moves & (self.moved_by.sum(axis=0) == 1))
            arm[own[-ARM_JOINTS:]] = True
        self.update(robot.home)
        self.error(self.rotations, self.positions)  # so that no cycle waits for its machine code

    def update(self, q: Array) -> None:
        """Place the robot at `q` (n,)."""
        self.rotations: Array
        self.positions: Array
        self.jacobian: Array
        # a copy: for one of another kind, such as a read-only one, it would be compiled anew
        self.rotations, self.positions, self.jacobian = placed(self._links, np.array(q, dtype=np.float64))

    def place(self, q: Array) -> None:
        """Place the robot at `q` (n,) [rad or m] without updating `jacobian`."""
        self.rotations, self.positions, _ = placed(self._links, np.array(q, dtype=np.float64))

    def error(self, rotations: Array, positions: Array) -> Array:
        """(6 h,) displacement from the present poses to the given ones: offset [m] over rotation vector [rad]."""
        return displacement(self.rotations, self.positions, rotations, positions).ravel()


# Where a robot's hands are and how they move with its joints, compiled: it is asked several times a cycle.
#
# The same as pinocchio says.


class Links(NamedTuple):
    """The joints of a robot and its hands, as they are carried.

    Attributes:
        tree: the joints.
        carriers: (h,) the joint that carries each hand.
        rotations: (h, 3, 3) of the hands in the frames of those.
        translations: (h, 3) likewise [m].
        moved_by: (h, n) whether joint j moves hand i.
    """

    tree: JointTree
    carriers: Indices
    rotations: Array
    translations: Array
    moved_by: NDArray[np.bool_]


def links_of(robot: RobotModel) -> Links:
    """The joints and hands of a robot."""
    frames = [robot.model.frames[robot.frame_of(hand)] for hand in robot.hands]
    carriers = np.array([int(frame.parentJoint) for frame in frames], dtype=np.intp)
    return Links(
        joint_tree(robot.model),
        carriers - 1,
        np.array([frame.placement.rotation for frame in frames]),
        np.array([frame.placement.translation for frame in frames]),
        joints_that_move(robot, carriers),
    )


@compiled
def placed(links: Links, q: Array) -> tuple[Array, Array, Array]:
    """The hands at `q` (n,).

    Returns:
        (h, 3, 3) axes and (h, 3) origins in the world [m], and the (6 h, n) Jacobian of the hands one under the other,
        linear over angular rows, world axes; zero for joints that do not move a hand.
    """
    placements, columns = placed_joints(links.tree, q)
    hands, n = links.moved_by.shape
    rotations, positions, jacobian = np.empty((hands, 3, 3)), np.empty((hands, 3)), np.zeros((6 * hands, n))
    for hand in range(hands):
        turn, shift, carrier = links.rotations[hand], links.translations[hand], 4 * links.carriers[hand]
        for row in range(3):
            a, b, c = placements[carrier, row], placements[carrier + 1, row], placements[carrier + 2, row]
            positions[hand, row] = placements[carrier + 3, row] + a * shift[0] + b * shift[1] + c * shift[2]
            for axis in range(3):
                rotations[hand, row, axis] = a * turn[0, axis] + b * turn[1, axis] + c * turn[2, axis]
        x, y, z = positions[hand, 0], positions[hand, 1], positions[hand, 2]
        for joint in range(n):
            if links.moved_by[hand, joint]:
                wx, wy, wz = columns[3, joint], columns[4, joint], columns[5, joint]
                jacobian[6 * hand, joint] = columns[0, joint] + wy * z - wz * y
                jacobian[6 * hand + 1, joint] = columns[1, joint] + wz * x - wx * z
                jacobian[6 * hand + 2, joint] = columns[2, joint] + wx * y - wy * x
                for axis in range(3, 6):
                    jacobian[6 * hand + axis, joint] = columns[axis, joint]
    return rotations, positions, jacobian


@compiled
def displacement(rotations: Array, positions: Array, to_rotations: Array, to_positions: Array) -> Array:
    """(h, 6) difference of hands' poses from (h, 3, 3), (h, 3): offset [m] over rotation vector [rad]."""
    hands = len(positions)
    found = np.empty((hands, 6))
    for hand in range(hands):
        for axis in range(3):
            found[hand, axis] = to_positions[hand, axis] - positions[hand, axis]
        found[hand, 3], found[hand, 4], found[hand, 5] = turn_between(rotations[hand], to_rotations[hand])
    return found


@compiled
def turned(rotations: Array, angles: Array) -> Array:
    """(h, 3, 3) orientations turned by rotation vectors (h, 3) in world axes [rad]."""
    found = np.empty_like(rotations)
    for hand in range(len(rotations)):
        x, y, z = angles[hand, 0], angles[hand, 1], angles[hand, 2]
        square = x * x + y * y + z * z
        angle = math.sqrt(square)
        # sin(a) / a and (1 - cos(a)) / a^2, the latter as a square, which keeps its digits
        sine = math.sin(angle) / angle if angle > 1e-8 else 1.0
        half = math.sin(0.5 * angle) / (0.5 * angle) if angle > 1e-8 else 1.0
        versine = 0.5 * half * half
        for column in range(3):
            a, b, c = rotations[hand, 0, column], rotations[hand, 1, column], rotations[hand, 2, column]
            along = x * a + y * b + z * c
            found[hand, 0, column] = a + sine * (y * c - z * b) + versine * (along * x - square * a)
            found[hand, 1, column] = b + sine * (z * a - x * c) + versine * (along * y - square * b)
            found[hand, 2, column] = c + sine * (x * b - y * a) + versine * (along * z - square * c)
    return found


# An object that all hands of a robot hold, and move as one: their poses to one another are kept.


class HeldObject:
    """The grasp of an object: its origin is midway between the hands, its axes were the world's when it was taken.

    Args:
        rotations: (h, 3, 3) axes of the hands in the world as they take it.
        positions: (h, 3) origins of the hands in the world [m].
    """

    def __init__(self, rotations: Array, positions: Array) -> None:
        self._rotations = rotations.copy()
        self._offsets: Array = positions - positions.mean(axis=0)

    def axes(self, rotations: Array) -> Array:
        """(3, 3) axes of the object in the world: the mean turn of the hands (h, 3, 3) since they took it."""
        turns = rotations @ self._rotations.transpose(0, 2, 1)
        mean = np.mean([pin.log3(turns[0].T @ turn) for turn in turns], axis=0)
        axes: Array = turns[0] @ pin.exp3(mean)
        return axes

    def placed(self, rotations: Array, positions: Array) -> tuple[Array, Array]:
        """Poses of the hands as they took the object, with the object where hands at these poses have it.

        Args:
            rotations: (h, 3, 3) axes of the hands in the world.
            positions: (h, 3) origins of the hands in the world [m].

        Returns:
            Axes and origins of the hands, kept together.
        """
        axes = self.axes(rotations)
        return axes @ self._rotations, positions.mean(axis=0) + self._offsets @ axes.T

    def parted(self, rotations: Array, positions: Array) -> tuple[float, float]:
        """By how much hands at these poses are off from how they took it, to one another [m, rad]."""
        back, turn = rotations[0] @ self._rotations[0].T, 0.0
        arms = (positions - positions[0]) - (self._offsets - self._offsets[0]) @ back.T
        for now, taken in zip(rotations, self._rotations, strict=True):
            turn = max(turn, float(np.linalg.norm(pin.log3((back @ taken).T @ now))))
        return float(np.linalg.norm(arms, axis=1).max()), turn

    def hands_twists(self, positions: Array, twist: Array) -> Array:
        """(h, 6) velocities of hands at (h, 3) for a twist (6,) of the object at its origin, world axes."""
        arms = positions - positions.mean(axis=0)
        velocities = twist[:3] + np.cross(twist[3:], arms)
        return np.hstack([velocities, np.tile(twist[3:], (len(arms), 1))])

    def together(self, positions: Array, rates: Array) -> Array:
        """(6 h,) rates of hands at (h, 3), turns as travel, projected on common rigid motion [m/s]."""
        columns = [self.hands_twists(positions, unit) for unit in np.eye(6)]
        for column in columns:
            column[:, 3:] *= LENGTH_M
        basis = np.array([column.ravel() for column in columns]).T
        twist = np.linalg.solve(basis.T @ basis, basis.T @ rates)
        kept: Array = basis @ twist
        return kept


# Limit the speed of a motion so that hands stay, or stay together, even if the gate brakes it at any time.


BRAKED_M, BRAKED_RAD = 2.5e-5, 5e-5
"""How far a hand may be off at the end of a brake, which is straight in joint space [m, rad]."""

PARTED_M, PARTED_RAD = 5e-4, 1e-3
"""How far hands that hold an object may be off from one another at the end of such a brake [m, rad]."""

GLIMPSE_S = 1e-3
"""Time over which the rates of a motion are compared [s]."""


def kept_while_braked(hands: Hands, q: Array, rates: Array, max_acceleration: Array) -> float:
    """The share of its rates from which a self-motion can be braked without moving the hands."""
    return min(1.0, allowed_while_braked(hands, q, rates, max_acceleration))


def allowed_while_braked(hands: Hands, q: Array, rates: Array, max_acceleration: Array) -> float:
    """The factor by which the rates of a self-motion may be multiplied so that a brake keeps the hands in place.

    The error of the hands after a straight brake grows with the square of the brake's length, and that length with the
    square of the speed.

    Args:
        hands: of the robot.
        q: (n,) configuration [rad or m].
        rates: (n,) of a motion that keeps the hands [rad/s or m/s].
        max_acceleration: (n,) of the robot [rad/s^2 or m/s^2].
    """
    brake_s = float(np.max(np.abs(rates) / max_acceleration))
    hands.place(q)
    rotations, positions = hands.rotations, hands.positions
    hands.place(q + 0.5 * brake_s * rates)
    off = np.linalg.norm(hands.error(rotations, positions).reshape(-1, 2, 3), axis=2).max(axis=0)
    excess = float(np.max(off / (BRAKED_M, BRAKED_RAD)))
    return float(excess**-0.25) if excess > 0.0 else math.inf


def kept_together_while_braked(
    hands: Hands, held: HeldObject, q: Array, rates: Array, max_acceleration: Array
) -> float:
    """By how much the rates of an object that hands hold may be multiplied for a brake to keep them together.

    Args:
        hands: of the robot.
        held: the object between them.
        q: (n,) configuration [rad or m].
        rates: (n,) of a motion that keeps them together [rad/s or m/s].
        max_acceleration: (n,) of the robot [rad/s^2 or m/s^2].
    """
    brake_s = float(np.max(np.abs(rates) / max_acceleration))
    hands.place(q + 0.5 * brake_s * rates)
    excess = float(np.max(np.array(held.parted(hands.rotations, hands.positions)) / (PARTED_M, PARTED_RAD)))
    return float(excess**-0.25) if excess > 0.0 else math.inf
