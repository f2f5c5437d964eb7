"""Bounding spheres of a robot, for the distances of Bjerkeng et al., III-D."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.compiled import compiled
from deltaq_cell.robot import RobotModel
from deltaq_controllers.kinematics import placement_views
from deltaq_protocol.arrays import Array

SPHERES_PER_WIDTH = 1.0
"""Spheres along the length of a body, per width of it; more hug it closer and cost more."""


class Spheres(NamedTuple):
    """Spheres that move with the joints of a robot.

    Attributes:
        joints: (m,) index of the carrying joint, as pinocchio counts: 1 for the first.
        centres: (m, 3) centres in the frames of these joints [m].
        radii: (m,) radii [m].
    """

    joints: NDArray[np.intp]
    centres: Array
    radii: Array

    @classmethod
    def of(cls, robot: RobotModel) -> Self:
        """Spheres that together contain every moving body of the robot."""
        joints: list[int] = []
        centres: list[Array] = []
        radii: list[float] = []
        for body in robot.geometry.geometryObjects:
            if body.parentJoint == 0:
                continue
            for centre, radius in cover(*local_box(body)):
                joints.append(body.parentJoint)
                centres.append(body.placement.act(centre))
                radii.append(radius)
        return cls(np.array(joints, dtype=np.intp), np.array(centres).reshape(-1, 3), np.array(radii))

    def placed(self, placements: Array) -> Array:
        """(m, 3) centres in the world [m], for the placements (4 n, 3) of the joints (`kinematics.placement_views`)."""
        return placed(self, placements)


@compiled
def placed(spheres: Spheres, placements: Array) -> Array:
    """`Spheres.placed`."""
    in_world = np.empty_like(spheres.centres)
    for i in range(len(in_world)):
        first = 4 * (spheres.joints[i] - 1)
        for axis in range(3):
            in_world[i, axis] = placements[first + 3, axis]
            for row in range(3):
                in_world[i, axis] += spheres.centres[i, row] * placements[first + row, axis]
    return in_world


class PlacedSpheres:
    """The spheres of a robot that moves.

    Args:
        robot: the robot.

    Attributes:
        radii: (m,) radii [m].
    """

    def __init__(self, robot: RobotModel) -> None:
        self._spheres = Spheres.of(robot)
        self._model, self._data = robot.model, robot.model.createData()
        self._placements = placement_views(self._data)
        self.radii = self._spheres.radii

    def at(self, q: Array) -> Array:
        """(m, 3) centres in the world at a configuration `q` (n,) [m]."""
        pin.forwardKinematics(self._model, self._data, q)
        return self._spheres.placed(np.concatenate(self._placements))


def local_box(body: Any) -> tuple[Array, Array]:
    """Lowest and highest corner of a pinocchio geometry object, (3,) each, in its own frame [m]."""
    body.geometry.computeLocalAABB()
    box = body.geometry.aabb_local
    return np.array(box.min_).ravel(), np.array(box.max_).ravel()


def cover(low: Array, high: Array) -> list[tuple[Array, float]]:
    """Equal spheres in a row that contain a box.

    Args:
        low: (3,) lowest corner [m].
        high: (3,) highest corner [m].

    Returns:
        Centre (3,) and radius of each sphere [m].
    """
    size, middle = high - low, 0.5 * (low + high)
    along = int(np.argmax(size))
    width = np.delete(size, along)
    count = max(1, math.ceil(SPHERES_PER_WIDTH * size[along] / max(float(width.max()), 1e-3)))
    count = min(count, 8)
    slice_length = size[along] / count
    radius = 0.5 * math.sqrt(slice_length**2 + float(width @ width))
    spheres = []
    for k in range(count):
        centre = middle.copy()
        centre[along] = low[along] + (k + 0.5) * slice_length
        spheres.append((centre, radius))
    return spheres
