"""Trajectories for tests, in words that are short."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ros_types import joint_trajectory

from deltaq_controllers.ros2.messages import JointTrajectory, JointTrajectoryPoint, RosTime
from deltaq_controllers.ros2.rmw import RosAttachment

ATTACHMENT = RosAttachment(1, 0, bytes(16)).encode()


def point(
    time_s: float, positions: Iterable[float], velocities: Iterable[float] = ()
) -> JointTrajectoryPoint:
    """A point; positions [rad or m], velocities [rad/s or m/s]."""
    moment = RosTime.of_ns(round(time_s * 1e9))
    return JointTrajectoryPoint(_floats(positions), _floats(velocities), time_from_start=moment)


def trajectory(joints: Iterable[str], *points: JointTrajectoryPoint, **header: Any) -> JointTrajectory:
    """A trajectory of these points."""
    return JointTrajectory(joint_names=tuple(joints), points=points, **header)


def encoded(message: JointTrajectory) -> bytes:
    """In CDR, by another library."""
    points = [
        (one.positions, one.velocities, one.accelerations, one.effort, _stamp(one.time_from_start))
        for one in message.points
    ]
    header = message.header
    return joint_trajectory(message.joint_names, points, _stamp(header.stamp), header.frame_id)


def _stamp(time: RosTime) -> tuple[int, int]:
    return time.sec, time.nanosec


def _floats(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
