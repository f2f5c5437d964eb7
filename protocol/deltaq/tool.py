"""A straight line of a robot's tool as a path of configurations, from the kinematics that a cell describes."""

import math

import numpy as np

from deltaq.motion import InvalidMotionError
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import RobotKinematics, RobotSummary

_SEGMENT_M = 0.005
_FEWEST, _MOST = 8, 400
_NEAR_M, _NEAR_RAD = 1e-7, 1e-7
_ITERATIONS = 20
_DAMPING = 1e-6


class Tool:
    """The pose of a robot's tool, and how its joints move it.

    Args:
        kinematics: of the robot, from the cell's description.
        summary: its joints and limits.
        frame: the tool's, one of the robot's carried frames.
    """

    def __init__(self, kinematics: RobotKinematics, summary: RobotSummary, frame: str = "tool") -> None:
        self._joints = [
            (joint.parent, np.array(joint.T_parent_joint), np.array(joint.axis))
            for joint in kinematics.joints
        ]
        carried = kinematics.frames[frame]
        self._carrier, self._T_joint_tool = carried.joint, np.array(carried.T_joint_frame)
        self._summary = summary

    def pose(self, q: Array) -> Array:
        """`T_world_tool` (4, 4) [m] at the configuration `q` (n,) [rad or m]."""
        placed = self._placements(q)
        pose: Array = (np.eye(4) if self._carrier < 0 else placed[self._carrier]) @ self._T_joint_tool
        return pose

    def jacobian(self, q: Array) -> Array:
        """(6, n) velocity of the tool's origin over its angular velocity, world axes, per joint rate."""
        placed, tool = self._placements(q), self.pose(q)
        jacobian: Array = np.zeros((6, len(self._joints)))
        joint = self._carrier
        while joint >= 0:
            axis = placed[joint][:3, :3] @ self._joints[joint][2]
            if self._summary.units[joint] == "m":
                jacobian[:3, joint] = axis
            else:
                jacobian[:3, joint] = np.cross(axis, tool[:3, 3] - placed[joint][:3, 3])
                jacobian[3:, joint] = axis
            joint = self._joints[joint][0]
        return jacobian

    def line(self, robot: str, start: Array, way: Array) -> Array:
        """Joint path (m + 1, n) that moves the tool straight by `way` (3,) from `start` (n,) without turning it.

        Args:
            robot: name of the robot, for errors.
            start: (n,) configuration at the beginning [rad or m].
            way: (3,) displacement in the world [m].

        Raises:
            ValueError: the tool cannot go there; the message says how far it can, and which joint limits it.
        """
        length = float(np.linalg.norm(way))
        segments = min(_MOST, max(_FEWEST, math.ceil(length / _SEGMENT_M)))
        goal, path = self.pose(start), [start]
        began = goal[:3, 3].copy()
        for segment in range(1, segments + 1):
            goal[:3, 3] = began + way * (segment / segments)
            q = self._inverse(goal, path[-1])
            keeps = self._kept_by(q)
            if keeps:
                far = length * (segment - 1) / segments
                raise InvalidMotionError(
                    f"the tool of {robot} can move {far:.3f} m of {length:.3f} m: {keeps}"
                )
            path.append(q)
        return np.stack(path)

    def _placements(self, q: Array) -> list[Array]:
        placed: list[Array] = []
        for (parent, T_parent_joint, axis), value, unit in zip(
            self._joints, q, self._summary.units, strict=True
        ):
            moved = np.eye(4)
            if unit == "m":
                moved[:3, 3] = axis * value
            else:
                moved[:3, :3] = _rotation(axis, float(value))
            placed.append((np.eye(4) if parent < 0 else placed[parent]) @ T_parent_joint @ moved)
        return placed

    def _inverse(self, goal: Array, q: Array) -> Array:
        """The configuration (n,) near `q` (n,) at which the tool is nearest to a pose (4, 4): damped least squares."""
        for _ in range(_ITERATIONS):
            pose = self.pose(q)
            turn = goal[:3, :3] @ pose[:3, :3].T
            off = np.concatenate([goal[:3, 3] - pose[:3, 3], _small_turn(turn)])
            if np.abs(off[:3]).max() < _NEAR_M and np.abs(off[3:]).max() < _NEAR_RAD:
                break
            jacobian = self.jacobian(q)
            q = q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), off)
        self._off = off
        return q

    def _kept_by(self, q: Array) -> str:
        summary = self._summary
        for name, unit, value, lower, upper in zip(
            summary.joints, summary.units, q, summary.lower, summary.upper, strict=True
        ):
            if not lower <= value <= upper:
                return (
                    f"joint {name} would be at {value:.4g} {unit}, its limits are {lower:.4g} and {upper:.4g}"
                )
        if np.abs(self._off[:3]).max() > 10 * _NEAR_M or np.abs(self._off[3:]).max() > 10 * _NEAR_RAD:
            return "the arm does not reach farther in that posture"
        return ""


def _rotation(axis: Array, angle: float) -> Array:
    """(3, 3) rotation by an angle [rad] about a unit axis (3,), by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Array = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    return rotation


def _small_turn(rotation: Array) -> Array:
    """(3,) axis times angle of a rotation (3, 3) that is small [rad]."""
    skew = rotation - rotation.T
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2.0
