"""Forward kinematics of six revolute joints in a row, and Newton's method on it, compiled.

With axes `h_i` and offsets `p_i` of the chain at zero, both in its base frame, the tool is at
`R = Rot(h_1, q_1) ... Rot(h_6, q_6) R_tool` and `p = p_1 + Rot(h_1, q_1) (p_2 + ...)`, as Elias and Wen write it
("IK-Geo", 2022). Where a method has found a configuration to some digits, or has none but a neighbour's, `refined`
finds the rest: Levenberg-Marquardt with damping by the error (Sugihara 2011), which is Newton's method next to a
solution and stays finite in a singularity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_controllers.vectors import turn_between
from deltaq_protocol.arrays import Array, Flags

# Matrices as small as an arm, in machine code that needs no library of linear algebra.


LEAST_DAMPING = 1e-13
"""Keeps a singular Jacobian's square positive."""


@compiled
def determinant_of(J: Array) -> float:
    """Determinant of an (n, n) matrix, by elimination; numba's own needs scipy."""
    A, determinant, n = J.copy(), 1.0, len(J)
    for k in range(n):
        pivot = k + int(np.argmax(np.abs(A[k:, k])))
        if A[pivot, k] == 0.0:
            return 0.0
        if pivot != k:
            determinant = -determinant
            for column in range(n):
                A[k, column], A[pivot, column] = A[pivot, column], A[k, column]
        determinant *= A[k, k]
        for row in range(k + 1, n):
            share = A[row, k] / A[k, k]
            for column in range(k, n):
                A[row, column] -= share * A[k, column]
    return determinant


@compiled
def product_of(A: Array, B: Array) -> Array:
    """(3, 3) product of two matrices."""
    C = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                C[i, j] += A[i, k] * B[k, j]
    return C


@compiled
def damped_step(J: Array, off: Array, damping: float) -> Array:
    """(n,) `(J^T J + damping I)^-1 J^T off` of J (m, n), by Cholesky's decomposition."""
    m, n = J.shape
    L, step = np.empty((n, n)), np.empty(n)
    for i in range(n):
        for j in range(i + 1):
            total = damping if i == j else 0.0
            for k in range(m):
                total += J[k, i] * J[k, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(max(total, LEAST_DAMPING**2)) if i == j else total / L[j, j]
    for i in range(n):
        total = 0.0
        for k in range(m):
            total += J[k, i] * off[k]
        for k in range(i):
            total -= L[i, k] * step[k]
        step[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= L[k, i] * step[k]
        step[i] = total / L[i, i]
    return step


JOINTS = 6

REACHED = 1e-10
"""A pose is reached if no coordinate [m] and no angle [rad] is off by more. Outside singularities it is 1e-13; there
a joint's error counts by its square only, and the last digits come slowly."""

EXACT = 1e-13
"""Below this error nothing is gained by another step [m, rad]."""

STEPS = 40
"""Most steps from one start; next to a solution three do."""

LONGEST_STEP = 0.6
"""Longest step in a joint [rad]: a longer one leaves the neighbourhood that the Jacobian describes."""

STUCK_ERROR, STUCK_STEP = 1e-4, 1e-2
"""With an error above the first, a step below the second [rad] that does not halve it leads nowhere."""

SMALL = 1e-9
"""A determinant below this is of no sign: the configuration is singular for all that rounding tells."""


class Chain(NamedTuple):
    """Six revolute joints in a row, all in the base frame, at zero.

    Attributes:
        axes: (6, 3) unit vectors.
        offsets: (7, 3) of each joint from the one before, and of the tool from the last [m].
        rotation: (3, 3) of the tool.
    """

    axes: Array
    offsets: Array
    rotation: Array


def chain_of(model: pin.Model, joints: NDArray[np.intp], T_last_tool: Array) -> Chain:
    """The chain of six joints of a robot; its base frame is that of the first joint at zero.

    Args:
        model: the robot.
        joints: (6,) their indices, each carried by the one before.
        T_last_tool: (4, 4) the tool in the frame of the last of them.
    """
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    base = data.oMi[int(joints[0]) + 1]
    axes, origins = np.empty((JOINTS, 3)), np.empty((JOINTS + 1, 3))
    for row, joint in enumerate(joints.tolist()):
        placed = base.actInv(data.oMi[joint + 1])
        column = pin.getJointJacobian(model, data, joint + 1, pin.LOCAL)[3:, joint]
        axes[row], origins[row] = placed.rotation @ column, placed.translation
    tool = placed.homogeneous @ T_last_tool
    origins[JOINTS] = tool[:3, 3]
    offsets = np.diff(origins, axis=0, prepend=np.zeros((1, 3)))
    return Chain(axes, offsets, np.ascontiguousarray(tool[:3, :3]))


@compiled
def placed(chain: Chain, q: Array) -> tuple[Array, Array, Array]:
    """(3, 3) rotation and (3,) position of the tool, and the (6, 6) Jacobian, linear over angular, base axes."""
    R, p = np.eye(3), np.zeros(3)
    axes, origins = np.empty((JOINTS, 3)), np.empty((JOINTS, 3))
    for joint in range(JOINTS):
        x, y, z = chain.axes[joint]
        for row in range(3):
            p[row] += R[row, 0] * chain.offsets[joint, 0]
            p[row] += R[row, 1] * chain.offsets[joint, 1] + R[row, 2] * chain.offsets[joint, 2]
            origins[joint, row] = p[row]
            axes[joint, row] = R[row, 0] * x + R[row, 1] * y + R[row, 2] * z
        c, s = math.cos(q[joint]), math.sin(q[joint])
        v = 1.0 - c
        for row in range(3):
            a, b, d = R[row, 0], R[row, 1], R[row, 2]
            R[row, 0] = a * (c + v * x * x) + b * (v * x * y + s * z) + d * (v * x * z - s * y)
            R[row, 1] = a * (v * x * y - s * z) + b * (c + v * y * y) + d * (v * y * z + s * x)
            R[row, 2] = a * (v * x * z + s * y) + b * (v * y * z - s * x) + d * (c + v * z * z)
    for row in range(3):
        p[row] += R[row, 0] * chain.offsets[6, 0]
        p[row] += R[row, 1] * chain.offsets[6, 1] + R[row, 2] * chain.offsets[6, 2]
    J = np.empty((6, JOINTS))
    for joint in range(JOINTS):
        a, b, d = axes[joint]
        x, y, z = p - origins[joint]
        J[0, joint], J[1, joint], J[2, joint] = b * z - d * y, d * x - a * z, a * y - b * x
        J[3, joint], J[4, joint], J[5, joint] = a, b, d
    return product_of(R, chain.rotation), p, J


@compiled
def error(R: Array, p: Array, T: Array) -> Array:
    """(6,) difference from a pose to `T` (4, 4): displacement [m] over rotation vector [rad], in base axes."""
    off = np.empty(6)
    for k in range(3):
        off[k] = T[k, 3] - p[k]
    off[3], off[4], off[5] = turn_between(R, T)
    return off


@compiled
def refined(chain: Chain, T: Array, q: Array, steps: int) -> tuple[Array, float, float]:
    """The configuration that Newton's method reaches.

    Args:
        chain: the joints.
        T: (4, 4) pose of the tool.
        q: (6,) where to begin [rad].
        steps: how many at most.

    Returns:
        (6,) configuration, the greatest component of the error there [m, rad], and the determinant of its Jacobian.
    """
    R, p, J = placed(chain, q)
    off = error(R, p, T)
    worst = np.abs(off).max()
    for _ in range(steps):
        if worst <= EXACT:
            break
        step = damped_step(J, off, 0.5 * (off * off).sum() + LEAST_DAMPING)
        longest = np.abs(step).max()
        if longest > LONGEST_STEP:
            step *= LONGEST_STEP / longest
        candidate = q + step
        R, p, candidate_J = placed(chain, candidate)
        candidate_off = error(R, p, T)
        candidate_worst = np.abs(candidate_off).max()
        if worst <= REACHED and candidate_worst >= worst:
            break  # rounding: no better
        if worst > STUCK_ERROR and longest < STUCK_STEP and candidate_worst > 0.5 * worst:
            break
        q, off, worst, J = candidate, candidate_off, candidate_worst, candidate_J
    return q, worst, determinant_of(J)


@compiled
def refined_all(
    chain: Chain, poses: Array, starts: Array, given: Flags, near: Array, steps: int
) -> tuple[Array, Flags]:
    """Distinct configurations that Newton's method reaches from many starts.

    Args:
        chain: the joints.
        poses: (N, 4, 4) of the tool.
        starts: (N, K, 6) where to begin [rad].
        given: (N, K) which of these are to be tried.
        near: (K,) only starts whose error is no greater are tried [m, rad].
        steps: how many at most from each.

    Returns:
        (N, K, 6) configurations in (-pi, pi], those that differ first and NaN after them, and (N, K) whether there is
        one.
    """
    count, most = starts.shape[0], starts.shape[1]
    found, exists = np.full((count, most, JOINTS), np.nan), np.zeros((count, most), dtype=np.bool_)
    for row in range(count):
        known = 0
        for start in range(most):
            if not given[row, start]:
                continue
            if near[start] < np.inf:
                R, p, _ = placed(chain, starts[row, start])
                if not np.abs(error(R, p, poses[row])).max() <= near[start]:
                    continue
            q, worst, _ = refined(chain, poses[row], starts[row, start].copy(), steps)
            if not worst <= REACHED:
                continue
            for joint in range(JOINTS):
                q[joint] -= 2.0 * math.pi * np.rint(q[joint] / (2.0 * math.pi))
                if q[joint] <= -math.pi:
                    q[joint] += 2.0 * math.pi
            if _is_new(found[row, :known], q):
                found[row, known], exists[row, known] = q, True
                known += 1
    return found, exists


@compiled
def followed(chain: Chain, poses: Array, start: Array, given: Flags) -> Array:
    """Configurations along paths of poses, each reached from the one before without passing a singularity.

    Two branches that meet in a fold have Jacobians with determinants of opposite signs, so a change of sign shows
    that Newton's method has changed the branch.

    Args:
        chain: the joints.
        poses: (N, P, 4, 4) of the tool.
        start: (N, 6) configurations that have the tool at the paths' first poses [rad].
        given: (N, P) which poses are finite.

    Returns:
        (N, P, 6) configurations; NaN from the first missing one on.
    """
    count, pieces = poses.shape[0], poses.shape[1]
    way = np.full((count, pieces, JOINTS), np.nan)
    for row in range(count):
        q, sign = start[row].copy(), 0.0
        for piece in range(pieces):
            if not given[row, piece]:
                break
            q, worst, determinant = refined(chain, poses[row, piece], q, STEPS)
            now = 0.0 if abs(determinant) < SMALL else math.copysign(1.0, determinant)
            if not worst <= REACHED or now * sign < 0.0:
                break
            sign = sign if now == 0.0 else now
            way[row, piece] = q
    return way


@compiled
def _is_new(known: Array, q: Array) -> bool:
    """Whether a configuration (6,) differs from all that are known (k, 6) by more than rounding, whole turns aside."""
    for row in range(len(known)):
        largest = 0.0
        for joint in range(JOINTS):
            apart = abs(known[row, joint] - q[joint])
            largest = max(largest, min(apart, 2.0 * math.pi - apart))
        if largest < 1e-6:
            return False
    return True
