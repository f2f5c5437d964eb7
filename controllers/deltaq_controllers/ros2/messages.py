"""The two ROS messages of the bridge, in the CDR that ROS 2 sends.

They are objects of rosbags, with the fields of the public interface definitions: `builtin_interfaces`, `std_msgs`,
`sensor_msgs` and `trajectory_msgs`. Joint quantities are in rad and m, rad/s and m/s, rad/s^2 and m/s^2, N m and N.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import RobotState, RobotSummary


class RefusedMessageError(DeltaqError):
    """A refused message: one line that names field, value and bound.

    Attributes:
        field: where in the message, e.g. `points[2].velocities`.
        why: a name under which refusals of this kind are counted.
    """

    def __init__(self, why: str, field: str, value: object, bound: str) -> None:
        super().__init__(f"{field} is {value}, allowed is {bound}")
        self.why = why
        self.field = field


MAX_MESSAGE_BYTES = 1024 * 1024
MAX_POINTS = 1_000
"""So many are read within three cycles of 12 ms, in which no other robot is answered."""

_STORE = get_typestore(Stores.ROS2_JAZZY)
_STORE.max_sequence_length = MAX_POINTS


@dataclass(frozen=True, slots=True)
class RosType:
    """A message type: `package/msg/Name`, and its hash as REP 2016 has it."""

    name: str
    hash: str

    @property
    def dds_name(self) -> str:
        """As DDS has it: `package::msg::dds_::Name_`."""
        package, kind, name = self.name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


JOINT_STATE, JOINT_TRAJECTORY = (
    RosType(name, _STORE.hash_rihs01(name))
    for name in ("sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory")
)


def decoded_trajectory(message: bytes) -> Any:
    """The `trajectory_msgs/msg/JointTrajectory` that came from any sender.

    Raises:
        RefusedMessageError: it is none, or too long.
    """
    if len(message) > MAX_MESSAGE_BYTES:
        size = f"{len(message)} bytes long"
        raise RefusedMessageError("too_long", "message", size, f"{MAX_MESSAGE_BYTES} or less")
    try:
        return _STORE.deserialize_cdr(message, JOINT_TRAJECTORY.name)
    except SerdeError as error:
        bound = f"a {JOINT_TRAJECTORY.name} in CDR, of {MAX_POINTS} points or less"
        raise RefusedMessageError("malformed", "message", f"malformed ({error})", bound) from error


# A robot's states as ROS messages.

_NEAR_CYCLES = 10
"""States farther apart tell no velocity."""


class JointStates:
    """Makes the joint states of one robot.

    Args:
        robot: its joints.
        cycle_s: of the cell.
    """

    def __init__(self, robot: RobotSummary, cycle_s: float) -> None:
        self._joints = list(robot.joints)
        self._cycle_s = cycle_s
        self._before: RobotState | None = None

    def message(self, state: RobotState, now_ns: int) -> bytes:
        """The measured positions and, from those of the state before, velocities; there is no effort.

        Args:
            state: newer than the one before.
            now_ns: time since the epoch [ns]. It is the stamp; the state's own is on the clock of the robot's server.
        """
        before, self._before = self._before, state
        q, velocity = np.array(state.q), np.empty(0)
        if before is not None and 0 < state.cycle - before.cycle <= _NEAR_CYCLES:
            velocity = (q - np.array(before.q)) / ((state.cycle - before.cycle) * self._cycle_s)
        kinds = _STORE.types
        stamp = kinds["builtin_interfaces/msg/Time"](*divmod(now_ns, 10**9))
        header = kinds["std_msgs/msg/Header"](stamp, "")
        made = kinds[JOINT_STATE.name](header, self._joints, q, velocity, np.empty(0))
        return bytes(_STORE.serialize_cdr(made, JOINT_STATE.name))
