"""The bodies of one robot, and how far they can travel."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltaq_cell.composite_model import JointRange
from deltaq_cell.extents import Extents
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array


class Bodies:
    """The bodies of one robot, their extents, and which joints move them.

    Attributes:
        objects: pinocchio geometry objects in the joined model.
        moved_by: (bodies, n) which joints move which body.
        extents: of the bodies, in the frames of their joints.
        links: indices of the bodies of each link, from the base outwards.
        radii: (bodies,) of the spheres around the bodies [m].
    """

    def __init__(self, robot: RobotModel, place: JointRange) -> None:
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
        self.extents = Extents(self.objects)
        self._width = self.extents.disc + self.extents.ball
        corners = self.extents.corners
        self._middles = (corners.max(axis=1) + corners.min(axis=1)) / 2
        reach = np.linalg.norm(corners - self._middles[:, None], axis=2).max(axis=1)
        # a disc lies across its axis, on which the middle is
        self.radii = np.hypot(reach, self.extents.disc) + self.extents.ball

    def placed(self, placements: Any) -> tuple[Array, Array, Array]:
        """Corners (bodies, k, 3) [m], axes (bodies, 3) and centres (bodies, 3) of the bodies in the world [m].

        Args:
            placements: pinocchio's placements of all joints in the world.
        """
        T_world_joint = np.array([placements[joint].homogeneous for joint in self._joints])
        T_world_joint[0] = np.eye(4)  # bodies that no joint moves are given in the world
        T_world_body = T_world_joint[self._parents]
        rotation, translation = T_world_body[:, :3, :3], T_world_body[:, :3, 3]
        corners = self.extents.corners @ rotation.transpose(0, 2, 1) + translation[:, None]
        axes = np.einsum("bij,bj->bi", rotation, self.extents.axis)
        centres = np.einsum("bij,bj->bi", rotation, self._middles) + translation
        return corners, axes, centres

    def on(self, link: list[int]) -> list[Any]:
        """The bodies with these indices."""
        return [self.objects[index] for index in link]

    def inflate(self, travel: Array) -> None:
        """Inflate each body by its travel, (bodies,) [m]."""
        for shape, radius in zip(self._shapes, travel.tolist(), strict=True):
            shape.setSweptSphereRadius(radius)

    def lever_arms(self, J: Array, corners: Array) -> Array:
        """(bodies, n) travel of each body per unit of each joint [m/rad or m/m].

        Args:
            J: (6, n) geometric Jacobian at the world's origin, linear rows first.
            corners: (bodies, k, 3) in the world [m].
        """
        count, most, _ = corners.shape
        n = J.shape[1]
        # velocity of point c under a unit velocity of joint j: w_j x c + v_j, as one (3, 3) matrix a joint
        spin = np.zeros((n, 3, 3))
        spin[:, 0, 1], spin[:, 0, 2], spin[:, 1, 2] = -J[5], J[4], -J[3]
        spin[:, 1, 0], spin[:, 2, 0], spin[:, 2, 1] = J[5], -J[4], J[3]
        velocity = spin.reshape(-1, 3) @ corners.reshape(-1, 3).T
        velocity += J[:3].T.reshape(-1, 1)
        square = np.square(velocity).reshape(n, 3, count, most).sum(axis=1).max(axis=2)
        turning = J[3:].any(axis=0)
        arms: Array = (np.sqrt(square.T) + self._width[:, None] * turning) * self.moved_by
        return arms
