"""Lines of sight among the bodies of a cell: which bodies stand between an eye and what it looks at.

A line is a thin rod. Of all bodies only those whose bounding sphere it passes are measured, by coal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array, Indices

ROD_M = 5e-4
"""Radius of the rod that stands for a line [m]."""

NEAR_EYE_M, NEAR_TARGET_M = 0.005, 0.01
"""How far from eye and target a line begins and ends: lenses have housings, and tools touch what they hold [m]."""

_Z = np.array([0.0, 0.0, 1.0])


@dataclass
class _Placed:
    """A robot: where its joints are, which of them carries each of its bodies, and its first body among all."""

    robot: RobotModel
    data: pin.Data
    joints: Indices
    first: int = 0

    @classmethod
    def of(cls, robot: RobotModel) -> _Placed:
        joints = [body.parentJoint for body in robot.geometry.geometryObjects]
        return cls(robot, robot.model.createData(), np.array(joints, dtype=np.intp))


class SightLines:
    """The bodies of a cell, placed at will, and the lines between them.

    Args:
        cell: the cell.

    Attributes:
        names: of the bodies, `robot/body` or `structure/body`.
    """

    def __init__(self, cell: CellModel) -> None:
        self._robots = {name: _Placed.of(robot) for name, robot in cell.robots.items()}
        bodies: list[Any] = []
        for placed in self._robots.values():
            placed.first = len(bodies)
            bodies += placed.robot.geometry.geometryObjects
        bodies += cell.structure
        self.names = tuple(body.name for body in bodies)
        self._bodies = bodies
        for body in bodies:
            body.geometry.computeLocalAABB()
        self._radii: Array = np.array([body.geometry.aabb_radius for body in bodies])
        # of a robot's body in the frame of its joint, of the others in the world
        self._local: Array = np.array([body.placement.act(body.geometry.aabb_center) for body in bodies])
        self._centres: Array = self._local.reshape(-1, 3).copy()
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self.place({name: robot.home for name, robot in cell.robots.items()})

    def place(self, configurations: Mapping[str, Array]) -> None:
        """Place robots at (n,) [rad or m] each; others stay where they are, at first at home."""
        for name, q in configurations.items():
            placed = self._robots[name]
            pin.forwardKinematics(placed.robot.model, placed.data, np.asarray(q, dtype=np.float64))
            T_world_joint = np.array([pose.homogeneous for pose in placed.data.oMi])[placed.joints]
            bodies = slice(placed.first, placed.first + len(placed.joints))
            turned = np.einsum("bij,bj->bi", T_world_joint[:, :3, :3], self._local[bodies])
            self._centres[bodies] = turned + T_world_joint[:, :3, 3]

    def blocked_by(self, eye: Array, target: Array) -> tuple[str, ...]:
        """Names of the bodies on the line from an eye (3,) to a target (3,) in the world [m], from the eye on."""
        way = target - eye
        length = float(np.linalg.norm(way))
        if length <= NEAR_EYE_M + NEAR_TARGET_M:
            return ()
        along = way / length
        begin, end = eye + NEAR_EYE_M * along, target - NEAR_TARGET_M * along
        beside = self._centres - begin
        reach = np.clip(beside @ along, 0.0, length - NEAR_EYE_M - NEAR_TARGET_M)
        off = np.linalg.norm(beside - reach[:, None] * along, axis=1)
        near = np.flatnonzero(off < self._radii + ROD_M)
        rod, pose = _rod(begin, end)
        blocking = [
            index
            for index in near[np.argsort(reach[near], kind="stable")].tolist()
            if self._touches(rod, pose, index)
        ]
        return tuple(self.names[index] for index in blocking)

    def bodies_at(self, point: Array) -> tuple[str, ...]:
        """Names of the bodies at a point (3,) in the world, or nearer to it than a line of sight would come [m]."""
        near = np.flatnonzero(np.linalg.norm(self._centres - point, axis=1) < self._radii + NEAR_TARGET_M)
        ball, pose = coal.Sphere(NEAR_TARGET_M), coal.Transform3s(np.eye(3), point)
        return tuple(self.names[index] for index in near.tolist() if self._touches(ball, pose, index))

    def _touches(self, shape: coal.Capsule | coal.Sphere, pose: coal.Transform3s, index: int) -> bool:
        body = self._bodies[index]
        where = body.placement
        for placed in self._robots.values():
            if placed.first <= index < placed.first + len(placed.joints):
                where = placed.data.oMi[body.parentJoint] * where
        place = coal.Transform3s(where.rotation, where.translation)
        self._result.clear()
        return bool(coal.collide(shape, pose, body.geometry, place, self._request, self._result))


def _rod(begin: Array, end: Array) -> tuple[coal.Capsule, coal.Transform3s]:
    """A thin capsule between two points (3,), and where it is: its axis is its z."""
    way = end - begin
    rotation = pin.Quaternion.FromTwoVectors(_Z, way).matrix()
    return coal.Capsule(ROD_M, float(np.linalg.norm(way))), coal.Transform3s(rotation, 0.5 * (begin + end))
