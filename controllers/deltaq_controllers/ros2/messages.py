"""The two ROS messages that the bridge speaks, and those that they are made of.

Names, types and order of the fields are those of the public interface definitions: `builtin_interfaces`, `std_msgs`,
`sensor_msgs` and `trajectory_msgs`. Joint quantities are in rad and m, rad/s and m/s, rad/s^2 and m/s^2, N m and N.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Self

from deltaq_controllers.ros2.cdr import CdrReader, CdrWriter
from deltaq_controllers.ros2.refusal import RefusedMessageError
from deltaq_controllers.ros2.rmw import RosType
from deltaq_protocol.messages import RobotState, RobotSummary

MAX_MESSAGE_BYTES = 1024 * 1024
MAX_POINTS = 1_000
"""So many are read within three cycles of 12 ms, in which no other robot is answered."""
MAX_JOINTS = 32
MAX_NAME_BYTES = 256

_POINT_BYTES = 24
"""Of a point without numbers: four counts and a duration."""

_NANOSECONDS = 10**9


@dataclass(frozen=True, slots=True)
class RosTime:
    """`builtin_interfaces/msg/Time` or, with a sign, `Duration`: `sec` [s] and `nanosec` [ns] beyond them."""

    sec: int = 0
    nanosec: int = 0

    @classmethod
    def of_ns(cls, time_ns: int) -> Self:
        """A time or duration from nanoseconds."""
        return cls(*divmod(time_ns, _NANOSECONDS))

    @property
    def total_s(self) -> float:
        """[s]."""
        return self.sec + self.nanosec / _NANOSECONDS

    def write(self, cdr: CdrWriter) -> None:
        """Append the fields."""
        cdr.int32(self.sec)
        cdr.uint32(self.nanosec)

    @classmethod
    def read(cls, cdr: CdrReader, name: str) -> Self:
        """Read the fields.

        Raises:
            RefusedMessageError: `nanosec` has a second in it.
        """
        sec, nanosec = cdr.int32(f"{name}.sec"), cdr.uint32(f"{name}.nanosec")
        if nanosec >= _NANOSECONDS:
            raise RefusedMessageError("time", f"{name}.nanosec", nanosec, f"less than {_NANOSECONDS}")
        return cls(sec, nanosec)


@dataclass(frozen=True, slots=True)
class Header:
    """`std_msgs/msg/Header`."""

    stamp: RosTime = field(default_factory=RosTime)
    frame_id: str = ""

    def write(self, cdr: CdrWriter) -> None:
        """Append the fields."""
        self.stamp.write(cdr)
        cdr.string(self.frame_id)

    @classmethod
    def read(cls, cdr: CdrReader) -> Self:
        """Read the fields; raises `RefusedMessageError`."""
        return cls(RosTime.read(cdr, "header.stamp"), cdr.string("header.frame_id", MAX_NAME_BYTES))


@dataclass(frozen=True, slots=True)
class JointState:
    """`sensor_msgs/msg/JointState`: of each joint, in one order; a quantity that is not known is left out."""

    header: Header = field(default_factory=Header)
    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()

    TYPE: ClassVar[RosType] = RosType(
        "sensor_msgs/msg/JointState",
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    )

    def encode(self) -> bytes:
        """The message in CDR."""
        cdr = CdrWriter()
        self.header.write(cdr)
        cdr.strings(self.name)
        for values in (self.position, self.velocity, self.effort):
            cdr.float64s(values)
        return cdr.message

    @classmethod
    def decode(cls, message: bytes) -> Self:
        """The same from CDR; raises `RefusedMessageError`."""
        cdr = CdrReader(message)
        header, name = Header.read(cdr), cdr.strings("name", MAX_JOINTS, MAX_NAME_BYTES)
        values = [cdr.float64s(quantity, MAX_JOINTS) for quantity in ("position", "velocity", "effort")]
        cdr.end()
        return cls(header, name, *values)


@dataclass(frozen=True, slots=True)
class JointTrajectoryPoint:
    """`trajectory_msgs/msg/JointTrajectoryPoint`, in the order of the trajectory's `joint_names`."""

    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    time_from_start: RosTime = field(default_factory=RosTime)

    def write(self, cdr: CdrWriter) -> None:
        """Append the fields."""
        for values in (self.positions, self.velocities, self.accelerations, self.effort):
            cdr.float64s(values)
        self.time_from_start.write(cdr)

    @classmethod
    def read(cls, cdr: CdrReader, name: str) -> Self:
        """Read the fields; raises `RefusedMessageError`."""
        positions = cdr.float64s(f"{name}.positions", MAX_JOINTS)
        velocities = cdr.float64s(f"{name}.velocities", MAX_JOINTS)
        accelerations = cdr.float64s(f"{name}.accelerations", MAX_JOINTS)
        effort = cdr.float64s(f"{name}.effort", MAX_JOINTS)
        return cls(positions, velocities, accelerations, effort, RosTime.read(cdr, f"{name}.time_from_start"))


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """`trajectory_msgs/msg/JointTrajectory`."""

    header: Header = field(default_factory=Header)
    joint_names: tuple[str, ...] = ()
    points: tuple[JointTrajectoryPoint, ...] = ()

    TYPE: ClassVar[RosType] = RosType(
        "trajectory_msgs/msg/JointTrajectory",
        "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    )

    def encode(self) -> bytes:
        """The message in CDR."""
        cdr = CdrWriter()
        self.header.write(cdr)
        cdr.strings(self.joint_names)
        cdr.uint32(len(self.points))
        for point in self.points:
            point.write(cdr)
        return cdr.message

    @classmethod
    def decode(cls, message: bytes) -> Self:
        """The same from CDR; raises `RefusedMessageError`."""
        if len(message) > MAX_MESSAGE_BYTES:
            size = f"{len(message)} bytes long"
            raise RefusedMessageError("too_long", "message", size, f"{MAX_MESSAGE_BYTES} or less")
        cdr = CdrReader(message)
        header, names = Header.read(cdr), cdr.strings("joint_names", MAX_JOINTS, MAX_NAME_BYTES)
        count = cdr.count("points", MAX_POINTS, _POINT_BYTES)
        points = tuple(JointTrajectoryPoint.read(cdr, f"points[{k}]") for k in range(count))
        cdr.end()
        return cls(header, names, points)


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
        self._joints = robot.joints
        self._cycle_s = cycle_s
        self._before: RobotState | None = None

    def message(self, state: RobotState, now_ns: int) -> JointState:
        """The measured positions and, from those of the state before, velocities; there is no effort.

        Args:
            state: newer than the one before.
            now_ns: time since the epoch [ns]. It is the stamp; the state's own is on the clock of the robot's server.
        """
        before, self._before = self._before, state
        velocity: tuple[float, ...] = ()
        if before is not None and 0 < state.cycle - before.cycle <= _NEAR_CYCLES:
            between_s = (state.cycle - before.cycle) * self._cycle_s
            velocity = tuple(
                (q - q_before) / between_s for q, q_before in zip(state.q, before.q, strict=True)
            )
        return JointState(Header(RosTime.of_ns(now_ns)), self._joints, state.q, velocity)
