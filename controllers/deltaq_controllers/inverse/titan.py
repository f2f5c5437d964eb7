"""Closed-form inverse of the Schilling Titan II.

Hooper and Noakes, II. Differences from the print, see the errata: the pose is that of the tool, whose offset is
removed first (B1); all eight branches are found (B2), and none is singular where the print divides by a sine or
cosine (B3); free joints follow a hint, and out of reach is reported (B4).

The forward kinematics that the closed form implies, in the arm's base frame with x along the azimuth axis:
`R = Rx(-t1) Ry(Phi) Rx(t5) Rz(t6)`, `Phi = t2 + t3 + t4`, and for the point where t5 and t6 meet
`P = Rx(-t1) [L1 z + L2 Ry(t2) z + L3 Ry(t2 + t3) z + L4 Ry(Phi) z]`.
"""

from dataclasses import dataclass

import numpy as np

from deltaq_controllers.inverse.branches import (
    FREE,
    Branches,
    NumberedBranches,
    checked_hint,
    checked_poses,
    two_links,
    wrapped,
)
from deltaq_protocol.arrays import Array, Flags

CHUNK = 2048
"""Poses that are solved together: their intermediate arrays stay in the processor's cache."""


@dataclass(frozen=True)
class TitanLengths:
    """Lengths of the links [m]. Stand-ins, not the maker's: their sum is the reach of a TITAN 4."""

    azimuth: float = 0.12
    upper_arm: float = 0.84
    forearm: float = 0.48
    wrist: float = 0.17
    tool: float = 0.31


class TitanInverse(NumberedBranches):
    """Inverse kinematics of a Titan II.

    Branches are numbered `4 * turned + 2 * flipped + elbow`: `turned` has t1 + pi, `flipped` has Phi + pi, and elbow 0
    has t3 >= 0.

    Args:
        lengths: of the links.
        T_hand_tool: (4, 4) maps the tool's coordinates into those of the hand, whose z axis is that of t6 and whose
            origin lies `lengths.tool` beyond the wrist; None for the hand itself.
    """

    def __init__(self, lengths: TitanLengths | None = None, T_hand_tool: Array | None = None) -> None:
        self.lengths = lengths or TitanLengths()
        T_wrist_tool = np.eye(4) if T_hand_tool is None else np.array(T_hand_tool, dtype=np.float64)
        T_wrist_tool[2, 3] += self.lengths.tool
        self._T_tool_wrist = np.linalg.inv(T_wrist_tool)
        self._turned_tool = not np.array_equal(T_wrist_tool[:3, :3], np.eye(3))

    def inverse(self, poses: Array, hint: Array | None = None) -> Branches:
        """All configurations that put the tool at each pose.

        Args:
            poses: (4, 4) or (N, 4, 4) poses of the tool in the arm's base frame; the rotations must be rotations.
            hint: (6,) configuration [rad] whose t1 and `t2 + t3 + t4` count where the pose leaves them free.

        Returns:
            Branches; free are `t1` (the wrist is on the azimuth axis) and `t2+t3+t4` (|t5| is 90 deg).

        Raises:
            InverseError: poses or hint have another shape.
        """
        batch = checked_poses(poses)
        hinted = checked_hint(hint)
        count = len(batch)
        q, exists = np.empty((6, 8, count)), np.empty((8, count), dtype=np.bool_)
        azimuth_free, pitch_free = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.bool_)
        for start in range(0, count, CHUNK):
            part = slice(start, min(start + CHUNK, count))
            azimuth_free[part], pitch_free[part] = self._solve(
                batch[part], hinted, q[:, :, part], exists[:, part]
            )
        solutions, valid = q.transpose(2, 1, 0), exists.T
        free = {"t1": azimuth_free, "t2+t3+t4": pitch_free}
        if np.ndim(poses) == 2:
            return Branches(solutions[0], valid[0], {name: flags[0] for name, flags in free.items()})
        return Branches(solutions, valid, free)

    def _solve(self, T: Array, hint: Array, q: Array, exists: Flags) -> tuple[Flags, Flags]:
        """Fill `q` (6, 8, n) and `exists` (8, n) for poses (n, 4, 4); tell where t1 and Phi are free."""
        R = T.transpose(1, 2, 0).copy()
        if self._turned_tool:
            R[:3] = np.einsum("ijn,jk->ikn", R[:3], self._T_tool_wrist)
        else:
            offset = self._T_tool_wrist[:3, 3]
            R[:3, 3] += R[:3, 0] * offset[0] + R[:3, 1] * offset[1] + R[:3, 2] * offset[2]
        lengths = self.lengths

        # t1 from the wrist's position, and everything rotated back by it: only rows 1 and 2 change
        Px, Py, Pz = R[0, 3], R[1, 3], R[2, 3]
        rho = np.sqrt(Py * Py + Pz * Pz)
        azimuth_free: Flags = rho < FREE
        t1 = np.arctan2(Py, Pz)
        with np.errstate(divide="ignore", invalid="ignore"):
            s1, c1 = Py / rho, Pz / rho
        if azimuth_free.any():
            t1[azimuth_free] = hint[0]
            s1[azimuth_free], c1[azimuth_free] = np.sin(hint[0]), np.cos(hint[0])
        row1 = c1 * R[1, :3] - s1 * R[2, :3]
        row2 = s1 * R[1, :3] + c1 * R[2, :3]

        # Phi from the direction of the t6 axis, then t5 and t6 from the remaining rotation: well conditioned for
        # any Phi
        a, b = R[0, 2], row2[2]
        across = np.sqrt(a * a + b * b)
        pitch_free: Flags = across < FREE
        pitch = np.arctan2(a, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            s, c = a / across, b / across
        if pitch_free.any():
            hinted = hint[1] + hint[2] + hint[3]
            # the hint's pitch belongs to the branch with the hint's azimuth
            turned = np.cos(t1[pitch_free] - hint[0]) < 0.0
            pitch[pitch_free] = np.where(turned, np.pi - hinted, hinted)
            s[pitch_free], c[pitch_free] = np.sin(pitch[pitch_free]), np.cos(pitch[pitch_free])
        t5 = np.arctan2(-row1[2], s * a + c * b)
        t6 = np.arctan2(s * row2[1] - c * R[0, 1], c * R[0, 0] - s * row2[0])

        # the planar arm, for (t1, Phi) in the order of the branches
        shape = (4, len(T))
        along, up = np.empty(shape), np.empty(shape)
        wrist_along, wrist_up = lengths.wrist * c, lengths.wrist * s
        along[0] = rho - lengths.azimuth - wrist_along
        along[1] = rho - lengths.azimuth + wrist_along
        along[2] = -rho - lengths.azimuth + wrist_along
        along[3] = -rho - lengths.azimuth - wrist_along
        up[0::2] = Px - wrist_up
        up[1::2] = Px + wrist_up
        mean, half, elbow, reached = two_links(along, up, lengths.upper_arm, lengths.forearm)

        q[0, :4], q[0, 4:] = t1, _opposite(t1)
        q[1, 0::2], q[1, 1::2] = mean - half, mean + half
        q[2, 0::2], q[2, 1::2] = elbow, -elbow
        flipped = _opposite(pitch)
        q[3, 0:2], q[3, 2:4], q[3, 4:6], q[3, 6:8] = pitch, flipped, -flipped, -pitch
        q[3] -= q[1] + q[2]
        q[1], q[3] = wrapped(q[1]), wrapped(q[3])
        t5_over = _opposite(t5)
        q[4, 0:2], q[4, 2:4], q[4, 4:6], q[4, 6:8] = t5, -t5_over, -t5, t5_over
        t6_over = _opposite(t6)
        q[5, 0:2], q[5, 2:4], q[5, 4:6], q[5, 6:8] = t6, t6_over, t6_over, t6
        exists[0::2] = exists[1::2] = reached
        if not reached.all():
            q[:, ~exists] = np.nan
        return azimuth_free, pitch_free


def _opposite(angle: Array) -> Array:
    """Angles plus half a turn, in (-pi, pi] if the angles are."""
    turned: Array = np.where(angle > 0.0, angle - np.pi, angle + np.pi)
    return turned
