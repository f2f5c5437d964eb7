"""Matrices as small as an arm, in machine code that needs no library of linear algebra."""

from __future__ import annotations

import math

import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_protocol.arrays import Array

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
