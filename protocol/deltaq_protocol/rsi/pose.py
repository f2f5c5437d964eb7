"""KUKA's way to write a pose: X, Y, Z and the angles A, B, C with `R = Rz(A) Ry(B) Rx(C)`."""

from __future__ import annotations

import math

from deltaq_protocol.arrays import Array


def pose_from_matrix(T: Array) -> tuple[float, float, float, float, float, float]:
    """X, Y, Z [m] and A, B, C [rad] of a (4, 4) transform; where B is ±90 degrees, C is 0."""
    (r11, r12, _, x), (r21, r22, _, y), (r31, r32, r33, z), _ = T.tolist()
    level = math.hypot(r11, r21)
    b = math.atan2(-r31, level)
    if level > 1e-9:
        return x, y, z, math.atan2(r21, r11), b, math.atan2(r32, r33)
    return x, y, z, math.atan2(-r12, r22), b, 0.0
