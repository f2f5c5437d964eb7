"""ROS messages as another library has them: the bytes that the bridge's are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"

Floats = Sequence[float]
Point = tuple[Floats, Floats, Floats, Floats, tuple[int, int]]
"""Positions, velocities, accelerations, effort, and `time_from_start` in s and ns."""


def serialized(kind: str, message: Any) -> bytes:
    """In CDR."""
    return bytes(STORE.serialize_cdr(message, kind))


def deserialized(kind: str, message: bytes) -> Any:
    """From CDR."""
    return STORE.deserialize_cdr(message, kind)


def joint_state(stamp: tuple[int, int], frame_id: str, names: Sequence[str], *values: Floats) -> bytes:
    """A JointState: positions, velocities, effort."""
    kind = STORE.types[JOINT_STATE]
    return serialized(JOINT_STATE, kind(_header(stamp, frame_id), list(names), *map(_array, values)))


def joint_trajectory(
    names: Sequence[str], points: Sequence[Point], stamp: tuple[int, int] = (0, 0), frame_id: str = ""
) -> bytes:
    """A JointTrajectory."""
    of_point = STORE.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    duration = STORE.types["builtin_interfaces/msg/Duration"]
    made = [of_point(*map(_array, point[:4]), duration(*point[4])) for point in points]
    kind = STORE.types[JOINT_TRAJECTORY]
    return serialized(JOINT_TRAJECTORY, kind(_header(stamp, frame_id), list(names), made))


def _header(stamp: tuple[int, int], frame_id: str) -> Any:
    return STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](*stamp), frame_id)


def _array(values: Floats) -> Any:
    return np.array(values, dtype=np.float64)
