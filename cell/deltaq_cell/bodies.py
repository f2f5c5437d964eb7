"""The bodies of one robot, and how far they can travel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.joined import Place
from deltaq_cell.robot import RobotModel

Array = NDArray[np.float64]


class Bodies:
    """The bodies of one robot, their corners, and which joints move them.

    Attributes:
        objects: pinocchio geometry objects in the joined model.
        moved_by: (bodies, n) which joints move which body.
        links: indices of the bodies of each link, from the base outwards.
        radii: (bodies,) of the balls around the bodies [m].
    """

    def __init__(self, robot: RobotModel, place: Place) -> None:
        self.slice_q = slice(place.first_q, place.first_q + robot.n)
        items = list(robot.geometry.geometryObjects)
        self.objects = [place.moved(item) for item in items]
        self._shapes = [item.geometry for item in self.objects]
        supports = [set(robot.model.supports[int(item.parentJoint)]) for item in items]
        self.moved_by = np.array([[joint in chain for joint in range(1, robot.n + 1)] for chain in supports])
        parents = [item.parentJoint for item in self.objects]
        self.links = [np.flatnonzero(np.array(parents) == joint).tolist() for joint in sorted(set(parents))]
        self._joints = range(place.first_joint, place.first_joint + robot.n + 1)
        self._parents = np.array([item.parentJoint for item in items])
        corners = np.stack([corners_of(item) for item in self.objects])
        self.radii = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
        self._corners = np.concatenate([corners, np.ones_like(corners[..., :1])], axis=2).transpose(0, 2, 1)

    def centres(self, placements: Any) -> Array:
        """(bodies, 3) centres of the boxes around the bodies, in the world [m]."""
        middles: Array = self._in_world(placements)[:3].mean(axis=2).T
        return middles

    def on(self, link: list[int]) -> list[Any]:
        """The bodies with these indices."""
        return [self.objects[index] for index in link]

    def inflate(self, travel: Array) -> None:
        """Inflate each body by its travel, (bodies,) [m]."""
        for shape, radius in zip(self._shapes, travel.tolist(), strict=True):
            shape.setSweptSphereRadius(radius)

    def lever_arms(self, J: Array, placements: Any) -> Array:
        """(bodies, n) travel of each body per unit of each joint [m/rad or m/m].

        Args:
            J: (6, n) geometric Jacobian at the world's origin, linear rows first.
            placements: pinocchio's placements of all joints in the world.
        """
        count, n = len(self.objects), J.shape[1]
        corners = self._in_world(placements).reshape(4, -1)
        # velocity of point c under a unit velocity of joint j: w_j x c + v_j, as one (3, 4) matrix a joint
        field = np.zeros((n, 3, 4))
        field[:, 0, 1], field[:, 0, 2], field[:, 1, 2] = -J[5], J[4], -J[3]
        field[:, 1, 0], field[:, 2, 0], field[:, 2, 1] = J[5], -J[4], J[3]
        field[:, :, 3] = J[:3].T
        velocity = (field.reshape(-1, 4) @ corners).reshape(n, 3, count, 8)
        speed = np.sqrt(np.square(velocity).sum(axis=1).max(axis=2))
        arms: Array = speed.T * self.moved_by
        return arms

    def _in_world(self, placements: Any) -> Array:
        """(4, bodies, 8) homogeneous corners of the boxes around the bodies."""
        T_world_joint = np.array([placements[joint].homogeneous for joint in self._joints])
        T_world_joint[0] = np.eye(4)  # bodies that no joint moves are given in the world
        return np.ascontiguousarray((T_world_joint[self._parents] @ self._corners).transpose(1, 0, 2))


def corners_of(item: Any) -> Array:
    """(8, 3) corners, in the joint's frame, of the box around a body."""
    item.geometry.computeLocalAABB()
    box = item.geometry.aabb_local
    low, high = np.array(box.min_), np.array(box.max_)
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=bool)
    corners = np.where(bits, high, low)
    placed: Array = corners @ item.placement.rotation.T + item.placement.translation
    return placed
