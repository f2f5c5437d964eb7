"""ROS messages for tests, written and read with all that ROS knows of them."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from deltaq_controllers.ros2.rmw import RosAttachment

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ATTACHMENT = RosAttachment(1, 0, bytes(16)).encode()

Floats = Iterable[float]


def point(
    time_s: float, positions: Floats, velocities: Floats = (), accelerations: Floats = (), effort: Floats = ()
) -> Any:
    """A point; positions [rad or m], velocities [rad/s or m/s], accelerations [rad/s^2 or m/s^2]."""
    rows = (np.array([*row], dtype=np.float64) for row in (positions, velocities, accelerations, effort))
    duration = STORE.types["builtin_interfaces/msg/Duration"](*divmod(round(time_s * 1e9), 10**9))
    return STORE.types["trajectory_msgs/msg/JointTrajectoryPoint"](*rows, duration)


def trajectory(joints: Iterable[str], *points: Any, stamp: tuple[int, int] = (0, 0)) -> Any:
    """A trajectory of these points."""
    header = STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](*stamp), "")
    return STORE.types[JOINT_TRAJECTORY](header, [*joints], [*points])


def encoded(trajectory: Any) -> bytes:
    """In CDR."""
    return bytes(STORE.serialize_cdr(trajectory, JOINT_TRAJECTORY))
