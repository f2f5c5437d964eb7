"""A quick bound for many pairs of bodies: which of them need not be measured?

Around every body that moves there is a sphere, around every one that stands still a box along the world's axes. Their
distance is a lower bound of the bodies', and for a thousand pairs at once it costs as much as measuring a few.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.extents import corners_of
from deltaq_cell.group import Group
from deltaq_protocol.arrays import Array


class Surroundings:
    """Balls and boxes around all bodies of a cell, kept up to date as robots are placed and inflated.

    Attributes:
        centre: (bodies, 3) in the world [m].
        half: (bodies, 3) half edges of the boxes of standing bodies, zero for spheres [m].
        radius: (bodies,) of the spheres, zero for boxes [m].
        inflation: (bodies,) travel that has been added [m].
    """

    def __init__(self) -> None:
        self._places: dict[int, int] = {}
        self._kept: list[Any] = []
        self.centre = np.empty((0, 3))
        self.half = np.empty((0, 3))
        self.radius = np.empty(0)
        self.inflation = np.empty(0)

    def add_moving(self, bodies: Sequence[Any], radii: Array) -> NDArray[np.intp]:
        """Add bodies with spheres (k,); returns their places."""
        zeros = np.zeros((len(bodies), 3))
        return self._add(bodies, zeros, zeros, radii)

    def add_standing(self, bodies: Sequence[Any]) -> None:
        """Add bodies that stand still in the world, with boxes."""
        corners = np.stack([corners_of(body) for body in bodies])
        low, high = corners.min(axis=1), corners.max(axis=1)
        self._add(bodies, (low + high) / 2, (high - low) / 2, np.zeros(len(bodies)))

    def place_of(self, body: Any) -> int:
        """Where a body is in the arrays."""
        return self._places[id(body)]

    def _add(self, bodies: Sequence[Any], centre: Array, half: Array, radius: Array) -> NDArray[np.intp]:
        first = len(self.radius)
        self._kept += bodies  # an identity is good for as long as its object lives
        self._places |= {id(body): first + index for index, body in enumerate(bodies)}
        self.centre = np.vstack([self.centre, centre])
        self.half = np.vstack([self.half, half])
        self.radius = np.append(self.radius, radius)
        self.inflation = np.append(self.inflation, np.zeros(len(bodies)))
        return np.arange(first, len(self.radius))


class BroadPhase:
    """Lower bounds of the distance that groups have beyond their stop distance.

    Args:
        groups: in any order, none without pairs.
        surroundings: complete already.
    """

    def __init__(self, groups: Sequence[Group], surroundings: Surroundings) -> None:
        self.groups = tuple(groups)
        self._around = surroundings
        counts = [len(group.pairs) for group in groups]
        self._starts = np.cumsum([0, *counts[:-1]], dtype=np.intp)
        pairs = [pair for group in groups for pair in group.pairs]  # a robot may have none to be checked
        self._first = np.array([surroundings.place_of(one) for one, _ in pairs], dtype=np.intp)
        self._second = np.array([surroundings.place_of(other) for _, other in pairs], dtype=np.intp)
        self._touch = surroundings.radius[self._first] + surroundings.radius[self._second]
        self._half = surroundings.half[self._first] + surroundings.half[self._second]
        self._stop = np.array([group.stop_distance_m for group in groups])

    def rooms(self) -> Array:
        """(groups,) lower bounds of least swept distance minus stop distance [m]."""
        around, first, second = self._around, self._first, self._second
        gaps = np.abs(around.centre[first] - around.centre[second]) - self._half
        # of a middle within a box as far as it is from there to the nearest face, the other way
        distances = np.minimum(gaps.max(axis=1, initial=-np.inf), 0.0)
        np.maximum(gaps, 0.0, out=gaps)
        distances += np.sqrt(np.einsum("ij,ij->i", gaps, gaps))
        distances -= self._touch + around.inflation[first] + around.inflation[second]
        least: Array = np.minimum.reduceat(distances, self._starts) - self._stop
        return least


class ScreenedGroups(list[Group]):
    """Groups that are checked together so often that a screen is kept for them; not to be changed.

    Attributes:
        screen: of exactly these groups.
    """

    def __init__(self, groups: Sequence[Group], surroundings: Surroundings) -> None:
        super().__init__(groups)
        self.screen = BroadPhase(groups, surroundings)
