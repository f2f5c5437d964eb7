"""The bodies of one robot, and how far they can travel."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array

# The extents of bodies: corners, widened by a ball and by a disc.


class Extents:
    """The extents of some bodies, each in the frame of the joint that moves it.

    Attributes:
        corners: (bodies, k, 3), bodies with fewer than k corners repeat their first [m].
        axis: (bodies, 3) unit vector across which the disc lies.
        disc: (bodies,) its radius, zero for bodies without [m].
        ball: (bodies,) radius of the ball, zero for bodies without [m].
    """

    def __init__(self, bodies: Sequence[Any]) -> None:
        corners, disc, ball = zip(*[_extent(body.geometry) for body in bodies], strict=True)
        self.disc: Array = np.array(disc)
        self.ball: Array = np.array(ball)
        most = max(len(points) for points in corners)
        padded = [np.vstack([points, np.tile(points[:1], (most - len(points), 1))]) for points in corners]
        rotation = np.array([body.placement.rotation for body in bodies])
        translation = np.array([body.placement.translation for body in bodies])
        self.corners: Array = np.array(padded) @ rotation.transpose(0, 2, 1) + translation[:, None]
        self.axis: Array = rotation[:, :, 2]


def _extent(shape: Any) -> tuple[Array, float, float]:
    """Corners (k, 3), radius of the disc and radius of the ball of one shape in its own frame."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), 0.0, shape.radius
    if isinstance(shape, coal.Capsule | coal.Cylinder):
        ends = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
        round_ended = isinstance(shape, coal.Capsule)
        return ends, 0.0 if round_ended else shape.radius, shape.radius if round_ended else 0.0
    if isinstance(shape, coal.Convex):
        return np.array([shape.point(index) for index in range(shape.num_points)]), 0.0, 0.0
    return _box_around(shape), 0.0, 0.0


def corners_of(body: Any) -> Array:
    """(8, 3) corners, in the joint's frame, of the box around a body."""
    corners: Array = _box_around(body.geometry) @ body.placement.rotation.T + body.placement.translation
    return corners


def _box_around(shape: Any) -> Array:
    """(8, 3) corners of the box around any shape, in its own frame."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=bool)
    return np.where(bits, high, low)


# All robots of a cell in one pinocchio model, so that bodies of different robots can be measured at once.

WORLD = 0
"""pinocchio's index of the joint that does not move."""


@dataclass(frozen=True)
class JointRange:
    """Where one robot's joints begin in the joined model."""

    first_joint: int
    first_q: int

    def moved(self, body: Any) -> Any:
        """A copy of a robot's body on its joint of the joined model, with a shape object of its own."""
        joint = body.parentJoint + self.first_joint if body.parentJoint != WORLD else WORLD
        return pin.GeometryObject(body.name, joint, body.placement, body.geometry.clone())


def composite_model(cell: CellModel) -> tuple[Any, dict[str, JointRange]]:
    """One `pinocchio.Model` of all robots of a cell, and each robot's place in it."""
    model = pin.Model()
    places = {}
    for name, robot in cell.robots.items():
        place = places[name] = JointRange(model.njoints - 1, model.nq)
        for joint in range(1, robot.model.njoints):
            parent = robot.model.parents[joint]
            model.addJoint(
                parent + place.first_joint if parent != WORLD else WORLD,
                robot.model.joints[joint],
                robot.model.jointPlacements[joint],
                f"{name}/{robot.model.names[joint]}",
            )
    return model, places


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
        middles = (corners.max(axis=1) + corners.min(axis=1)) / 2
        reach = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
        # a disc lies across its axis, on which the middle is
        self.radii = np.hypot(reach, self.extents.disc) + self.extents.ball

    def corners_in_world(self, placements: Any) -> Array:
        """(bodies, k, 3) corners of the bodies in the world [m].

        Args:
            placements: pinocchio's placements of all joints in the world.
        """
        T_world_joint = np.array([placements[joint].homogeneous for joint in self._joints])
        T_world_joint[0] = np.eye(4)  # bodies that no joint moves are given in the world
        T_world_body = T_world_joint[self._parents]
        rotation, translation = T_world_body[:, :3, :3], T_world_body[:, :3, 3]
        corners: Array = self.extents.corners @ rotation.transpose(0, 2, 1) + translation[:, None]
        return corners

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
