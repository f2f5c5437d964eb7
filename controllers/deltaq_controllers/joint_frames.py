"""Poses of a model's joints, compiled: pinocchio's results, in arrays for compiled functions.

Reading the frames of pinocchio's data one by one costs several times their computation. The gate's kernel
places joints likewise, in arrays of its own (`deltaq_cell.kernel.place`). Machine code is kept package by package, so a
compiled function calls none of another package.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array, Indices


class JointTree(NamedTuple):
    """Joints as they carry one another, each after the one that carries it.

    Attributes:
        parents: (n,) the joint that carries each, -1 for the world.
        rotations: (n, 3, 3) of each joint's frame in that of the one before, at zero.
        translations: (n, 3) likewise [m].
        axes: (n, 3) unit vectors in the joints' own frames.
        revolute: (n,) False for prismatic ones.
    """

    parents: Indices
    rotations: Array
    translations: Array
    axes: Array
    revolute: NDArray[np.bool_]


def joint_tree(model: Any) -> JointTree:
    """The joints of a pinocchio model, each revolute or prismatic."""
    data, n = model.createData(), model.nv
    pin.computeJointJacobians(model, data, pin.neutral(model))
    own = [
        np.reshape(pin.getJointJacobian(model, data, joint + 1, pin.LOCAL), (6, n))[:, joint]
        for joint in range(n)
    ]
    revolute = np.array([bool(column[3:].any()) for column in own])
    places = [model.jointPlacements[joint + 1] for joint in range(n)]
    return JointTree(
        np.array([int(model.parents[joint + 1]) - 1 for joint in range(n)], dtype=np.intp),
        np.array([place.rotation for place in places]),
        np.array([place.translation for place in places]),
        np.array([column[3:] if turns else column[:3] for column, turns in zip(own, revolute, strict=True)]),
        revolute,
    )


@compiled
def placed_joints(tree: JointTree, q: Array) -> tuple[Array, Array]:
    """The joints at `q` (n,) [rad or m].

    Returns:
        (4 n, 3) placements, as `kinematics.placement_views` has them, and (6, n) unit twists of the joints at the
        world's origin, linear over angular.
    """
    n = len(q)
    placements, columns = np.empty((4 * n, 3)), np.zeros((6, n))
    for joint in range(n):
        first, before = 4 * joint, 4 * tree.parents[joint]
        here, shift = tree.rotations[joint], tree.translations[joint]
        x, y, z = tree.axes[joint, 0], tree.axes[joint, 1], tree.axes[joint, 2]
        cos, sin = math.cos(q[joint]), math.sin(q[joint])
        for row in range(3):
            if before < 0:
                r0, r1, r2, at = here[row, 0], here[row, 1], here[row, 2], shift[row]
            else:
                a, b, c = placements[before, row], placements[before + 1, row], placements[before + 2, row]
                r0 = a * here[0, 0] + b * here[1, 0] + c * here[2, 0]
                r1 = a * here[0, 1] + b * here[1, 1] + c * here[2, 1]
                r2 = a * here[0, 2] + b * here[1, 2] + c * here[2, 2]
                at = placements[before + 3, row] + a * shift[0] + b * shift[1] + c * shift[2]
            along = r0 * x + r1 * y + r2 * z
            if tree.revolute[joint]:
                # a row r turns to cos r + sin (r x axis) + (1 - cos) (r . axis) axis
                rest = (1.0 - cos) * along
                placements[first, row] = cos * r0 + sin * (r1 * z - r2 * y) + rest * x
                placements[first + 1, row] = cos * r1 + sin * (r2 * x - r0 * z) + rest * y
                placements[first + 2, row] = cos * r2 + sin * (r0 * y - r1 * x) + rest * z
                columns[3 + row, joint] = along
            else:
                placements[first, row], placements[first + 1, row], placements[first + 2, row] = r0, r1, r2
                at += q[joint] * along
                columns[row, joint] = along
            placements[first + 3, row] = at
        if tree.revolute[joint]:
            a, b, c = placements[first + 3, 0], placements[first + 3, 1], placements[first + 3, 2]
            x, y, z = columns[3, joint], columns[4, joint], columns[5, joint]
            columns[0, joint], columns[1, joint], columns[2, joint] = (
                b * z - c * y,
                c * x - a * z,
                a * y - b * x,
            )
    return placements, columns
