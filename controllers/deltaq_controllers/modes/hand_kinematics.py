"""Where a robot's hands are and how they move with its joints, compiled: it is asked several times a cycle.

The same as pinocchio says.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.joint_frames import JointTree, joint_tree, placed_joints
from deltaq_controllers.kinematics import joints_that_move
from deltaq_controllers.vectors import turn_between
from deltaq_protocol.arrays import Array, Indices


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
    """(h, 6) what leads the hands from poses (h, 3, 3), (h, 3) to others: offset [m] over rotation vector [rad]."""
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
