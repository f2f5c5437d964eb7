"""Criteria of hands: singular values of their Jacobians, and the hand that counts, which is the worst."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.arrays import Array


def of_worst(values: Array, better: str, each: Array) -> Array:
    """(N, n) of `each` hand (N, h, n) that of the hand whose value (N, h) is the worst."""
    worst = values.argmin(axis=1) if better == "more" else values.argmax(axis=1)
    chosen: Array = each[np.arange(len(each)), worst]
    return chosen


def singular(J: Array, H: Array) -> tuple[Array, Array]:
    """(N, h, k) singular values of J (N, h, r, n), and their (N, h, k, n) derivatives from H (N, h, r, n, n)."""
    U, values, Vt = np.linalg.svd(J, full_matrices=False)
    return values, np.einsum("nhak,nhaji,nhkj->nhki", U, H, Vt, optimize=True)
