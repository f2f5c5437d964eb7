"""Lines of sight in a cell: the bodies between a camera and its target.

A line is a thin rod. Coal measures only bodies whose bounding sphere it meets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array, Indices
from deltaq_protocol.messages import ToolPose, Vector3, ViewTarget
from deltaq_protocol.messages.motion import AIM_M

ROD_M = 5e-4
"""Radius of the rod that stands for a line [m]."""

NEAR_EYE_M, NEAR_TARGET_M = 0.005, 0.01
"""Distance of the line's ends from lens and target [m]: lenses have housings, and tools touch their workpieces."""

_SLANT = 1e-6
"""Length square to the line below which a way out of a body is along the line, and tells no side."""

_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class BesideLine:
    """A body on a line of sight, or beside it.

    Attributes:
        name: of the body, `robot/body` or `structure/body`.
        distance_m: from the line, negative if the line is in it.
        share: where the line is nearest to it, from 0 at the eye to 1 at the target.
        aside: (3,) unit vector square to the line, from the body to the line: the way that clears it.
    """

    name: str
    distance_m: float
    share: float
    aside: Array


class _Line(NamedTuple):
    """Where it begins (3,) [m], the unit vector along it (3,), and its length [m]."""

    begin: Array
    along: Array
    length: float


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
        self._measure, self._nearest = coal.DistanceRequest(), coal.DistanceResult()
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
        line = _line(eye, target)
        if line is None:
            return ()
        near, reach = self._near(line, ROD_M)
        rod, pose = _rod(line)
        blocking = [
            index
            for index in near[np.argsort(reach[near], kind="stable")].tolist()
            if self._touches(rod, pose, index)
        ]
        return tuple(self.names[index] for index in blocking)

    def beside(self, eye: Array, target: Array, within_m: float) -> tuple[BesideLine, ...]:
        """The bodies on, or near, the line from an eye (3,) to a target (3,), world coordinates [m].

        None of the bodies at the target is among them.
        """
        line = _line(eye, target)
        if line is None:
            return ()
        along, length = line.along, float(np.linalg.norm(target - eye))
        near, _ = self._near(line, within_m)
        at_target = frozenset(self.bodies_at(target))
        rod, pose = _rod(line)
        found = []
        for index in near.tolist():
            if self.names[index] in at_target:
                continue
            self._nearest.clear()
            distance = coal.distance(
                rod, pose, self._bodies[index].geometry, self._place_of(index), self._measure, self._nearest
            )
            if distance < within_m:
                # from the line to the body; a rod that is in a body is told the shortest way out of it
                aside = -np.asarray(self._nearest.normal)
                aside -= (aside @ along) * along
                share = float((self._nearest.getNearestPoint1() - eye) @ along) / length
                size = float(np.linalg.norm(aside))
                if size > _SLANT:
                    found.append(BesideLine(self.names[index], distance, share, aside / size))
        return tuple(found)

    def bodies_at(self, point: Array) -> tuple[str, ...]:
        """Names of the bodies at a point (3,) in the world, or nearer to it than a line of sight would come [m]."""
        near = np.flatnonzero(np.linalg.norm(self._centres - point, axis=1) < self._radii + NEAR_TARGET_M)
        ball, pose = coal.Sphere(NEAR_TARGET_M), coal.Transform3s(np.eye(3), point)
        return tuple(self.names[index] for index in near.tolist() if self._touches(ball, pose, index))

    def _near(self, line: _Line, within_m: float) -> tuple[Indices, Array]:
        """Bodies whose bounding spheres are within a distance of a line, and how far along it all are (b,) [m]."""
        beside = self._centres - line.begin
        reach = np.clip(beside @ line.along, 0.0, line.length)
        off = np.linalg.norm(beside - reach[:, None] * line.along, axis=1)
        return np.flatnonzero(off < self._radii + within_m), reach

    def _touches(self, shape: coal.Capsule | coal.Sphere, pose: coal.Transform3s, index: int) -> bool:
        self._result.clear()
        body, place = self._bodies[index], self._place_of(index)
        return bool(coal.collide(shape, pose, body.geometry, place, self._request, self._result))

    def _place_of(self, index: int) -> coal.Transform3s:
        body = self._bodies[index]
        where = body.placement
        for placed in self._robots.values():
            if placed.first <= index < placed.first + len(placed.joints):
                where = placed.data.oMi[body.parentJoint] * where
        return coal.Transform3s(where.rotation, where.translation)


def _line(eye: Array, target: Array) -> _Line | None:
    """The line from an eye to a target, without its ends; None if nothing is left of it."""
    way = target - eye
    distance = float(np.linalg.norm(way))
    length = distance - NEAR_EYE_M - NEAR_TARGET_M
    if length <= 0.0:
        return None
    along = way / distance
    return _Line(eye + NEAR_EYE_M * along, along, length)


def _rod(line: _Line) -> tuple[coal.Capsule, coal.Transform3s]:
    """A thin capsule along a line, and where it is: its axis is its z."""
    rotation = pin.Quaternion.FromTwoVectors(_Z, line.along).matrix()
    middle = line.begin + 0.5 * line.length * line.along
    return coal.Capsule(ROD_M, line.length), coal.Transform3s(rotation, middle)


# Position of a camera's target in the world, to mark it.


def focus_of(target: ViewTarget, T_world_tool: ToolPose | None) -> Vector3 | None:
    """Position of a target in the world [m]; None if it is on a tool whose pose is unknown.

    Args:
        target: the target of a camera.
        T_world_tool: pose of the tool of the robot that the target names.
    """
    if target.focus_m is not None:
        return target.focus_m
    if T_world_tool is None:
        return None
    w, x, y, z = T_world_tool.quaternion_wxyz
    placed = pin.XYZQUATToSE3(np.array([*T_world_tool.position, x, y, z, w]))
    x, y, z = placed.act(np.array(target.aim_offset_m or AIM_M)).tolist()
    return x, y, z
