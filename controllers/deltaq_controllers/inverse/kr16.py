"""Closed-form inverse of the KUKA KR 16: an arm of two links, offset at shoulder and elbow, with a spherical wrist.

Geometry and signs are those of the model `kr16`: A1, A4 and A6 turn about negative axes, and all zero is the arm
stretched out level. With `e(t) = (cos t, -sin t)` in the vertical plane of the arm the wrist is at
`0.26 + 0.68 e(A2) + hypot(0.67, 0.035) e(A2 + A3 + psi)`, `psi = atan2(0.035, 0.67)`, and its rotation is
`Rz(-A1) Ry(A2 + A3) Rx(-A4) Ry(A5) Rx(-A6)`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.inverse.branches import (
    FREE,
    Branches,
    NumberedBranches,
    checked_hint,
    checked_poses,
    two_links,
    wrapped,
)
from deltaq_protocol.arrays import Array

SHOULDER_HEIGHT = 0.675
"""Height of A2 over the base [m]."""
SHOULDER_OFFSET = 0.26
"""From the A1 axis to A2 [m]."""
UPPER_ARM = 0.68
"""From A2 to A3 [m]."""
FOREARM = (0.67, 0.035)
"""From A3 to the wrist, along the arm and below it [m]."""
FLANGE = 0.158
"""From the wrist to the flange [m]."""

T_WRIST_FLANGE = np.array([[0, 0, 1, FLANGE], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
"""The flange's frame in the frame that A6 turns: Ry(90), so that its z axis points out of the robot."""

FOREARM_LENGTH = math.hypot(*FOREARM)
FOREARM_ANGLE = math.atan2(FOREARM[1], FOREARM[0])


class Kr16Inverse(NumberedBranches):
    """Inverse kinematics of a KR 16, all eight branches.

    Branches are numbered `4 * behind + 2 * elbow + flipped`: `behind` has A1 turned by half a turn, elbow 0 has
    `A3 + psi >= 0` (elbow up), and `flipped` has A5 < 0.

    Args:
        T_flange_tool: (4, 4) maps the tool's coordinates into the flange's, whose z axis points out of the robot.
    """

    def __init__(self, T_flange_tool: Array | None = None) -> None:
        T_wrist_tool = T_WRIST_FLANGE if T_flange_tool is None else T_WRIST_FLANGE @ T_flange_tool
        self._T_tool_wrist = np.linalg.inv(T_wrist_tool)

    def inverse(self, poses: Array, hint: Array | None = None) -> Branches:
        """All configurations that put the tool at each pose.

        Args:
            poses: (4, 4) or (N, 4, 4) poses of the tool in the robot's base frame; the rotations must be rotations.
            hint: (6,) configuration [rad] whose A1 and A4 count where the pose leaves them free.

        Returns:
            Branches; free are `a1` (the wrist is on the A1 axis) and `a4` (A5 is 0).

        Raises:
            InverseError: poses or hint have another shape.
        """
        T = checked_poses(poses) @ self._T_tool_wrist
        hinted = checked_hint(hint)
        count = len(T)
        q, exists = np.empty((6, 8, count)), np.empty((8, count), dtype=np.bool_)

        x, y, height = T[:, 0, 3], T[:, 1, 3], T[:, 2, 3] - SHOULDER_HEIGHT
        rho = np.hypot(x, y)
        a1_free = rho < FREE
        a1 = np.where(a1_free, hinted[0], -np.arctan2(y, x))
        q[0, :4] = wrapped(a1)
        q[0, 4:] = wrapped(a1 + np.pi)

        along = np.stack([rho - SHOULDER_OFFSET, -rho - SHOULDER_OFFSET])
        mean, half, elbow, reached = two_links(
            along, np.broadcast_to(-height, along.shape), UPPER_ARM, FOREARM_LENGTH
        )
        # the order of the branches: behind, elbow, flipped
        for behind in range(2):
            for sign, low in ((1.0, 4 * behind), (-1.0, 4 * behind + 2)):
                q[1, low : low + 2] = wrapped(mean[behind] - sign * half[behind])
                q[2, low : low + 2] = wrapped(sign * elbow[behind] - FOREARM_ANGLE)
                exists[low : low + 2] = reached[behind]

        a4_free = np.zeros(count, dtype=np.bool_)
        for low in range(0, 8, 2):
            a4_free |= _wrist(T[:, :3, :3], q[:, low : low + 2], hinted) & exists[low]
        q[:, ~exists] = np.nan
        solutions, valid = q.transpose(2, 1, 0), exists.T
        free = {"a1": a1_free, "a4": a4_free}
        if np.ndim(poses) == 2:
            return Branches(solutions[0], valid[0], {name: flags[0] for name, flags in free.items()})
        return Branches(solutions, valid, free)


def _wrist(R: Array, q: Array, hint: Array) -> NDArray[np.bool_]:
    """Fill A4 to A6 of two branches (6, 2, n) that share A1 to A3; tell where A4 is free.

    Args:
        R: (n, 3, 3) rotation of the wrist in the base.
        q: (6, 2, n) configurations, A1 to A3 known.
        hint: (6,) whose A4 counts where it is free.
    """
    c1, s1 = np.cos(q[0, 0]), np.sin(q[0, 0])
    pitch = q[1, 0] + q[2, 0]
    c, s = np.cos(pitch), np.sin(pitch)
    # M = Ry(-pitch) Rz(A1) R, which is Rx(-A4) Ry(A5) Rx(-A6)
    level = c1[:, None] * R[:, 0] - s1[:, None] * R[:, 1]
    M1 = s1[:, None] * R[:, 0] + c1[:, None] * R[:, 1]
    M0 = c[:, None] * level - s[:, None] * R[:, 2]
    M2 = s[:, None] * level + c[:, None] * R[:, 2]
    bend = np.hypot(M1[:, 0], M2[:, 0])
    free: NDArray[np.bool_] = bend < FREE
    a4 = np.where(free, hint[3], np.arctan2(-M1[:, 0], -M2[:, 0]))
    c4, s4 = np.cos(a4), np.sin(a4)
    # N = Rx(A4) M, which is Ry(A5) Rx(-A6), so that A5 and A6 are well conditioned for any A4
    N1 = c4[:, None] * M1 - s4[:, None] * M2
    N20 = s4 * M1[:, 0] + c4 * M2[:, 0]
    a5 = np.arctan2(-N20, M0[:, 0])
    a6 = np.arctan2(N1[:, 2], N1[:, 1])
    q[3, 0], q[3, 1] = wrapped(a4), wrapped(a4 + np.pi)
    q[4, 0], q[4, 1] = a5, -a5
    q[5, 0], q[5, 1] = a6, wrapped(a6 + np.pi)
    return free
