"""CDR coding of the two ROS messages of the bridge, and of the messages that they contain.

Names, types and order of the fields are those of the public interface definitions: `builtin_interfaces`, `std_msgs`,
`sensor_msgs` and `trajectory_msgs`. Joint quantities are in rad and m, rad/s and m/s, rad/s^2 and m/s^2, N m and N.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar, Self

from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import RobotState, RobotSummary

# The refusal of a ROS message: one line that names field, value and bound.


class RefusedMessageError(DeltaqError):
    """A refused message.

    Attributes:
        field: where in the message, e.g. `points[2].velocities`.
        why: a name under which refusals of this kind are counted.
    """

    def __init__(self, why: str, field: str, value: object, bound: str) -> None:
        super().__init__(f"{field} is {value}, allowed is {bound}")
        self.why = why
        self.field = field


# CDR as ROS 2 sends it: version 1 of XCDR, little-endian, behind four bytes of encapsulation.
#
# A number is aligned to its own size, counted from behind the encapsulation. A string has its length before it and a
# zero behind it, and both count the zero. A sequence has its count before it; an empty one of 8-byte numbers is not
# aligned.
# Source: OMG Data-Distribution Service Interoperability Wire Protocol 2.2, 10.2, and DDS X-Types 1.3, 7.4.
#
# Messages may come from any sender: a length is compared with its bound and with the remaining bytes before memory
# of that length is allocated.


ENCAPSULATION = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian; no options."""

_PADDING = 3
"""Bytes that may follow the last field: some senders fill up to a multiple of four."""


class CdrWriter:
    """Appends fields in their order; `message` returns the bytes."""

    def __init__(self) -> None:
        self._body = bytearray()

    @property
    def message(self) -> bytes:
        """All that was written, with its encapsulation."""
        return ENCAPSULATION + bytes(self._body)

    def int32(self, value: int) -> None:
        """A signed number of four bytes."""
        self._align(4)
        self._body += struct.pack("<i", value)

    def uint32(self, value: int) -> None:
        """An unsigned number of four bytes."""
        self._align(4)
        self._body += struct.pack("<I", value)

    def string(self, value: str) -> None:
        """A string in UTF-8."""
        text = value.encode() + b"\x00"
        self.uint32(len(text))
        self._body += text

    def strings(self, values: Iterable[str]) -> None:
        """A sequence of strings."""
        values = tuple(values)
        self.uint32(len(values))
        for value in values:
            self.string(value)

    def float64s(self, values: Iterable[float]) -> None:
        """A sequence of doubles."""
        values = tuple(values)
        self.uint32(len(values))
        if values:
            self._align(8)
            self._body += struct.pack(f"<{len(values)}d", *values)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)


class CdrReader:
    """Reads fields in their order; each names itself for the error.

    Args:
        message: with its encapsulation.

    Raises:
        RefusedMessageError: from here and from every method, if the bytes are not such a field.
    """

    def __init__(self, message: bytes) -> None:
        if message[:2] != ENCAPSULATION[:2]:
            kind = message[:4].hex(" ") or "missing"
            raise RefusedMessageError(
                "malformed", "encapsulation", kind, "00 01 00 00 (plain CDR, little-endian)"
            )
        if len(message) < len(ENCAPSULATION):
            raise RefusedMessageError("malformed", "message", f"{len(message)} bytes", "4 bytes or more")
        self._body = message[len(ENCAPSULATION) :]
        self._at = 0

    def int32(self, field: str) -> int:
        """A signed number of four bytes."""
        (value,) = struct.unpack("<i", self._bytes(4, 4, field))
        return int(value)

    def uint32(self, field: str) -> int:
        """An unsigned number of four bytes."""
        (value,) = struct.unpack("<I", self._bytes(4, 4, field))
        return int(value)

    def count(self, field: str, most: int, element_bytes: int) -> int:
        """How many elements a sequence has.

        Args:
            field: its name.
            most: elements that are allowed.
            element_bytes: least size of one [bytes].
        """
        count = self.uint32(field)
        if count > most:
            raise RefusedMessageError("too_long", field, f"of length {count}", f"{most} or less")
        if count * element_bytes > len(self._body) - self._at:
            left = f"no more than the {len(self._body) - self._at} bytes that follow hold"
            raise RefusedMessageError("malformed", field, f"of length {count}", left)
        return count

    def string(self, field: str, most_bytes: int) -> str:
        """A string of up to so many bytes in UTF-8, its zero included."""
        size = self.count(field, most_bytes, 1)
        text = self._bytes(size, 1, field)
        if not text or text[-1] != 0 or 0 in text[:-1]:
            raise RefusedMessageError("malformed", field, "not ended by its only zero", "a CDR string")
        try:
            return text[:-1].decode()
        except UnicodeDecodeError:
            raise RefusedMessageError("malformed", field, "not in UTF-8", "a text in UTF-8") from None

    def strings(self, field: str, most: int, most_bytes: int) -> tuple[str, ...]:
        """A sequence of up to `most` strings."""
        count = self.count(field, most, 5)
        return tuple(self.string(f"{field}[{k}]", most_bytes) for k in range(count))

    def float64s(self, field: str, most: int) -> tuple[float, ...]:
        """A sequence of up to `most` doubles of any value."""
        count = self.count(field, most, 8)
        if not count:
            return ()
        return struct.unpack(f"<{count}d", self._bytes(8 * count, 8, field))

    def end(self) -> None:
        """Nothing may be left but padding."""
        left = len(self._body) - self._at
        if left > _PADDING:
            raise RefusedMessageError(
                "malformed", "message", f"{left} bytes too long", "the fields of its type"
            )

    def _bytes(self, size: int, alignment: int, field: str) -> bytes:
        begin = self._at + -self._at % alignment
        end = begin + size
        if end > len(self._body):
            given = f"cut off after {len(self._body) + len(ENCAPSULATION)} bytes"
            raise RefusedMessageError("malformed", field, given, "a whole field")
        self._at = end
        return self._body[begin:end]


MAX_MESSAGE_BYTES = 1024 * 1024
MAX_POINTS = 1_000
"""So many are read within three cycles of 12 ms, in which no other robot is answered."""
MAX_JOINTS = 32
MAX_NAME_BYTES = 256

_POINT_BYTES = 24
"""Of a point without numbers: four counts and a duration."""

_NANOSECONDS = 10**9


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


@dataclass(frozen=True, slots=True)
class JointTrajectoryPoint:
    """`trajectory_msgs/msg/JointTrajectoryPoint`, in the order of the trajectory's `joint_names`."""

    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    time_from_start: RosTime = field(default_factory=RosTime)

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

    @classmethod
    def decode(cls, message: bytes) -> Self:
        """Decode one from CDR; raises `RefusedMessageError`."""
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
