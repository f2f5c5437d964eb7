"""Bounds of the distance between capsules, boxes and each other, to know which pairs need to be measured.

A capsule is represented by the middles of its two halves: its axis can be nearer than they are by a quarter of its
length, and not farther. All in single precision, laid out for the processor's vector units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array

Single = NDArray[np.float32]

ROUNDING_M = 1e-3
"""Largest error of a bound in single precision, for bodies within some 10 m [m]."""

_TINY = np.float32(1e-12)


@dataclass(frozen=True)
class Standing:
    """Bodies that stand still.

    Attributes:
        middles: (s, 3) middles of capsules in the world [m].
        halves: (s, 3) halves of their axes, as vectors [m].
        centres: (b, 3) centres of boxes in the world [m].
        turns: (b, 3, 3) their rotations.
        sizes: (b, 3) halves of their sizes [m].
    """

    middles: Array
    halves: Array
    centres: Array
    turns: Array
    sizes: Array


class CriterionBounds:
    """Bounds of the distance of every pair of one robot's capsules with each other and with standing bodies.

    Args:
        lengths: (c,) half lengths of the robot's capsules [m].
        standing: bodies that stand still.
        least: (c, c + s + b) distance of axes at which nothing is left of the stop distance; -inf for a pair that
            is not measured [m].
    """

    def __init__(self, lengths: Array, standing: Standing, least: Array) -> None:
        self._standing = standing
        self._slack = (0.5 * lengths[:, None]).astype(np.float32)
        self._least = least.astype(np.float32)
        # boxes side by side, coordinate by coordinate
        self._turns = standing.turns.transpose(2, 0, 1).reshape(-1, 3)
        self._sizes = standing.sizes.T.reshape(-1, 1).astype(np.float32)

    def of(self, middles: Array, halves: Array) -> tuple[Single, Single]:
        """Lower and upper bounds (N, c (c + s + b)), infinite for pairs that are not measured.

        Args:
            middles: (N, c, 3) middles of the robot's capsules in the world [m].
            halves: (N, c, 3) halves of their axes [m].
        """
        count, c = middles.shape[:2]
        s = len(self._standing.middles)
        origin = middles.mean(axis=(0, 1))  # single precision is best near the origin
        own, stand = middles - origin, self._standing.middles - origin
        points = np.concatenate([own - 0.5 * halves, own + 0.5 * halves], axis=1).astype(np.float32)
        upper = np.empty((count, c, self._least.shape[1]), dtype=np.float32)
        upper[:, :, :c] = _nearer(_from_axes(points, own, halves))
        upper[:, :, c : c + s] = _nearer(_from_axes(points, stand, self._standing.halves))
        np.sqrt(np.maximum(upper[:, :, : c + s], 0.0), out=upper[:, :, : c + s])
        if len(self._standing.centres):
            upper[:, :, c + s :] = _nearer(self._from_boxes(points, origin))
        upper -= self._least
        lower = upper - self._slack
        return lower.reshape(count, -1), upper.reshape(count, -1)

    def _from_boxes(self, points: Single, origin: Array) -> Single:
        """(N, p, b) distances of points (N, p, 3) from the boxes; negative inside."""
        boxes = len(self._standing.centres)
        centres = ((self._standing.centres - origin)[:, None] @ self._standing.turns)[:, 0].T.reshape(-1, 1)
        beyond = self._turns.astype(np.float32) @ points.reshape(-1, 3).T
        beyond -= centres.astype(np.float32)
        np.abs(beyond, out=beyond)
        beyond -= self._sizes
        x, y, z = beyond.reshape(3, boxes, -1)
        inside = np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
        np.maximum(beyond, 0.0, out=beyond)
        beyond *= beyond
        distance: Single = np.sqrt(x + y + z) + inside
        return distance.T.reshape(*points.shape[:2], boxes)


def _nearer(distances: Single) -> Single:
    """(N, c, k) the lesser of the distances (N, 2 c, k) of a capsule's two points."""
    c = distances.shape[1] // 2
    return np.minimum(distances[:, :c], distances[:, c:])


def _from_axes(points: Single, middles: Array, halves: Array) -> Single:
    """(N, p, k) squared distances of points (N, p, 3) from axes with middles and halves (N, k, 3) or (k, 3).

    With `d = p - m` it is `|d|^2 + t (t |h|^2 - 2 d h)`, `t = d h / |h|^2` cut to the axis; `|d|^2` and `d h` are
    products of vectors of five.
    """
    squares = np.einsum("npi,npi->np", points, points)[:, :, None]
    five = np.concatenate([points, squares, np.ones_like(squares)], axis=2)
    zero, one = np.zeros((*middles.shape[:-1], 1)), np.ones((*middles.shape[:-1], 1))
    distant = np.concatenate([-2.0 * middles, one, (middles * middles).sum(axis=-1, keepdims=True)], axis=-1)
    ahead = np.concatenate([halves, zero, -(middles * halves).sum(axis=-1, keepdims=True)], axis=-1)
    squared: Single = five @ np.swapaxes(distant.astype(np.float32), -1, -2)
    along: Single = five @ np.swapaxes(ahead.astype(np.float32), -1, -2)
    length = np.maximum((halves * halves).sum(axis=-1).astype(np.float32), _TINY)[..., None, :]
    share = np.clip(along / length, -1.0, 1.0)
    along *= -2.0
    along += share * length
    along *= share
    squared += along
    return squared
