"""Distances of single pairs of bodies, as coal measures them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.group import Nearest, make_reproducible
from deltaq_protocol.arrays import Array


class Meter:
    """Measures pairs at the middle of the boxes where robots are placed, without any inflation.

    Args:
        model: of all robots.
        bodies: all bodies of the cell, the shapes their own.
        pairs: (pairs, 2) numbers of bodies.
    """

    def __init__(self, model: Any, bodies: Sequence[Any], pairs: NDArray[np.int64]) -> None:
        self._model, self._data = model, model.createData()
        self._geometry = pin.GeometryModel()
        for body in bodies:
            own = pin.GeometryObject(body.name, body.parentJoint, body.placement, body.geometry.clone())
            own.geometry.setSweptSphereRadius(0.0)
            self._geometry.addGeometryObject(own)
        # the bodies of two robots are paired from either side, and measured from one
        numbers: dict[tuple[int, int], int] = {}
        for first, second in np.sort(pairs, axis=1).tolist():
            numbers.setdefault((first, second), len(numbers))
        for first, second in numbers:
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))
        self._number = [numbers[min(pair), max(pair)] for pair in map(tuple, pairs.tolist())]
        self._turned = (pairs[:, 0] > pairs[:, 1]).tolist()
        self._names = [(bodies[first].name, bodies[second].name) for first, second in pairs.tolist()]
        self._placed = self._geometry.createData()
        make_reproducible(self._placed)

    def place(self, q: Array) -> None:
        """Place all robots at `q`, in the order of the model."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)

    def measure(self, pair: int, travel_m: float) -> Nearest:
        """Measure a pair whose bodies travel together by `travel_m`."""
        number = self._number[pair]
        pin.computeDistance(self._geometry, self._placed, number)
        result = self._placed.distanceResults[number]
        points = (np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2()))
        distance: float = result.min_distance
        return Nearest(
            self._names[pair], distance - travel_m, distance, points[::-1] if self._turned[pair] else points
        )
