"""Forward kinematics from the text of a URDF, by nothing but matrices: to judge what others made of it."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from deltaq_cell.description import Pose, RobotDescription
from deltaq_protocol.arrays import Array


class UrdfKinematics:
    """A robot of a cell, as its URDF and its description place it.

    Args:
        description: of the robot, for its base and joint order.
        urdf: the text.
    """

    def __init__(self, description: RobotDescription, urdf: str) -> None:
        robot = ET.fromstring(urdf)
        self._base = _pose(description.base)
        self._order = list(description.joint_names)
        joints = {joint.find("child").get("link"): joint for joint in robot.iter("joint")}
        children = [link.get("name") for link in robot.iter("link")]
        link = next((name for name in children if name in ("flange", "tool0")), children[-1])
        self._chain = []
        while link in joints:
            self._chain.insert(0, joints[link])
            link = joints[link].find("parent").get("link")

    def at(self, q: Sequence[float], carried: Pose) -> Array:
        """(4, 4) pose in the world of what the flange carries, at q (n,) [rad or m]."""
        T = self._base
        for joint in self._chain:
            origin, axis = joint.find("origin"), joint.find("axis")
            T = T @ _transform(_numbers(origin, "xyz"), _numbers(origin, "rpy"))
            if joint.get("name") in self._order:
                value = q[self._order.index(joint.get("name"))]
                direction = np.array(_numbers(axis, "xyz"))
                if joint.get("type") == "prismatic":
                    T = T @ _transform(value * direction, (0, 0, 0))
                else:
                    T = T @ _turn(direction, value)
        return T @ _pose(carried)


def _numbers(element: ET.Element | None, name: str) -> tuple[float, ...]:
    text = None if element is None else element.get(name)
    return tuple(float(number) for number in (text or "0 0 0").split())


def _turn(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] += np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
    return T


def _transform(xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    roll, pitch, yaw = rpy
    T = _turn(np.array([0, 0, 1]), yaw) @ _turn(np.array([0, 1, 0]), pitch) @ _turn(np.array([1, 0, 0]), roll)
    T[:3, 3] = xyz
    return T


def _pose(pose: Pose) -> Array:
    return _transform(pose.position_m, np.deg2rad(pose.rpy_deg))
