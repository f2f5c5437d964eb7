"""The description of a cell, as its YAML file gives it.

Field names carry their unit. People read and write degrees here; `JointDescription` and everything
behind it returns rad and m. The numbers of a robot in joint order come from `RobotDescription.lower` and
its siblings.
"""

from __future__ import annotations

from functools import cached_property
from ipaddress import ip_address
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

Array = NDArray[np.float64]
Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[a-z][a-z0-9_-]*$")]
JointName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z_][A-Za-z0-9_.-]*$")]
"""As its URDF names it."""
Endpoint = Annotated[str, Field(pattern=r"^tcp/[^/\s]+:\d{1,5}$")]


MOST_ROBOTS = 8
"""In one cell: one thread decides for all, and the number of pairs grows with the square."""


class DescriptionModel(BaseModel):
    """Base: immutable, and a field that is not known is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Pose(DescriptionModel):
    """A pose by position and roll, pitch, yaw: `R = Rz(yaw) Ry(pitch) Rx(roll)`."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)


class JointDescription(DescriptionModel):
    """Limits and home of one joint; either all in degrees (revolute) or all in metres (prismatic)."""

    home_deg: FiniteFloat | None = None
    lower_deg: FiniteFloat | None = None
    upper_deg: FiniteFloat | None = None
    max_velocity_deg_s: Positive | None = None
    max_acceleration_rad_s2: Positive | None = None
    tracking_tolerance_deg: Positive = 2.0
    home_m: FiniteFloat | None = None
    lower_m: FiniteFloat | None = None
    upper_m: FiniteFloat | None = None
    max_velocity_m_s: Positive | None = None
    max_acceleration_m_s2: Positive | None = None
    tracking_tolerance_m: Positive = 0.02

    @model_validator(mode="after")
    def _has_one_unit_and_ordered_limits(self) -> Self:
        revolute = (self.home_deg, self.lower_deg, self.upper_deg, self.max_velocity_deg_s,
                    self.max_acceleration_rad_s2)  # fmt: skip
        prismatic = (self.home_m, self.lower_m, self.upper_m, self.max_velocity_m_s,
                     self.max_acceleration_m_s2)  # fmt: skip
        given = [all(v is not None for v in group) for group in (revolute, prismatic)]
        other = [any(v is not None for v in group) for group in (prismatic, revolute)]
        if not any(given) or (given[0] and other[0]) or (given[1] and other[1]):
            raise ValueError(
                "a joint needs home_deg, lower_deg, upper_deg, max_velocity_deg_s and "
                "max_acceleration_rad_s2 (revolute), or home_m, lower_m, upper_m, max_velocity_m_s and "
                "max_acceleration_m_s2 (prismatic), and none of the other kind"
            )
        if not self.lower < self.upper:
            raise ValueError(f"the lower limit {self.lower:g} must be below the upper limit {self.upper:g}")
        if not self.lower <= self.home <= self.upper:
            raise ValueError(f"home {self.home:g} must lie between {self.lower:g} and {self.upper:g}")
        return self

    @property
    def revolute(self) -> bool:
        """True for a revolute joint, False for a prismatic one."""
        return self.lower_deg is not None

    def _si(self, degrees: float | None, metres: float | None) -> float:
        if degrees is not None:
            return float(np.deg2rad(degrees))
        assert metres is not None  # the validator ensures it
        return metres

    @property
    def home(self) -> float:
        """Home position [rad or m]."""
        return self._si(self.home_deg, self.home_m)

    @property
    def lower(self) -> float:
        """Lower limit [rad or m]."""
        return self._si(self.lower_deg, self.lower_m)

    @property
    def upper(self) -> float:
        """Upper limit [rad or m]."""
        return self._si(self.upper_deg, self.upper_m)

    @property
    def max_velocity(self) -> float:
        """Largest speed [rad/s or m/s]."""
        return self._si(self.max_velocity_deg_s, self.max_velocity_m_s)

    @property
    def max_acceleration(self) -> float:
        """Largest acceleration and deceleration [rad/s^2 or m/s^2]."""
        value = self.max_acceleration_rad_s2 if self.revolute else self.max_acceleration_m_s2
        assert value is not None  # the validator ensures it
        return value

    @property
    def tracking_tolerance(self) -> float:
        """How far the measured joint may be off the commanded path [rad or m]."""
        return float(np.deg2rad(self.tracking_tolerance_deg)) if self.revolute else self.tracking_tolerance_m


class BoxShape(DescriptionModel):
    """A box, its frame at its centre."""

    kind: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]


class CylinderShape(DescriptionModel):
    """A cylinder along z, its frame at its centre."""

    kind: Literal["cylinder"]
    radius_m: Positive
    length_m: Positive


class CapsuleShape(DescriptionModel):
    """A cylinder along z with round ends, its frame at its centre; the length leaves the ends out."""

    kind: Literal["capsule"]
    radius_m: Positive
    length_m: Positive


class SphereShape(DescriptionModel):
    """A sphere."""

    kind: Literal["sphere"]
    radius_m: Positive


Shape = Annotated[BoxShape | CylinderShape | CapsuleShape | SphereShape, Field(discriminator="kind")]
Colour = tuple[float, float, float, float]


class Body(DescriptionModel):
    """A rigid body: fixed to the world (structure) or to a link of a robot (attachment)."""

    shape: Shape
    pose: Pose = Pose()
    colour_rgba: Colour = (0.6, 0.6, 0.62, 1.0)


class Attachment(Body):
    """A body bolted to a link of a robot, e.g. a control box or a camera housing."""

    link: str


class Camera(DescriptionModel):
    """A camera in the flange frame; its z axis is the view axis, its x axis points up in the picture."""

    pose: Pose = Pose()
    vertical_view_deg: Annotated[float, Field(gt=1, lt=170)] = 45.0


class Tool(DescriptionModel):
    """What the flange carries: where the tool frame is, and the bodies of the tool, in the flange frame."""

    frame: Pose = Pose()
    bodies: dict[Name, Body] = {}


class Hand(Tool):
    """A hand of a robot that has several: a tool on a link of its own; the frame and the bodies are in its frame."""

    link: str


def _is_loopback(address: str) -> bool:
    try:
        return ip_address(address).is_loopback
    except ValueError:  # a name
        return address == "localhost"


class RsiDescription(DescriptionModel):
    """A KUKA controller reached over RSI: the Robot Server listens on `address:port`, the KRC sends to it."""

    kind: Literal["rsi"]
    address: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)]
    krc_address: str | None = None
    """The KRC's own address: datagrams from others are dropped. Needed unless `address` is a loopback."""
    ethernet_xml: str
    """The RSI configuration that the KRC has loaded, beside the cell's file or shipped."""
    krc: Literal["krc2", "krc4"] = "krc2"
    ipoc_step: Annotated[int, Field(ge=1, le=1000)] | None = None
    """By how much the KRC's IPOC grows in a cycle; none: learned from its first telegrams."""
    inputs: dict[Name, str] = {}
    """Per digital input of the robot the TAG of the BOOL of SEND that carries it, such as Di.I1."""
    outputs: dict[Name, str] = {}
    """Per digital output of the robot the TAG of the BOOL of RECEIVE that carries it, such as Do.O1."""
    stop: str | None = None
    """TAG of the BOOL of RECEIVE that ends the motion on the KRC's side, such as Stop; none if it has none."""
    max_correction_deg: Positive | None = None
    """Largest correction sent to a rotating axis; none: as far as the joint limits, and a margin, allow."""
    max_correction_mm: Positive | None = None
    """The same for a linear axis."""
    control_port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """The emulator's operator panel listens here; a real KRC has none."""

    @model_validator(mode="after")
    def _listens_to_one_krc(self) -> Self:
        if self.krc_address is None and not _is_loopback(self.address):
            raise ValueError(
                f"krc_address is not given though address is {self.address}: whoever reaches that address could "
                "pass for the KRC; give the KRC's own address, such as krc_address: 192.168.10.20"
            )
        return self

    @model_validator(mode="after")
    def _keeps_stop_from_users(self) -> Self:
        for name, tag in self.outputs.items():
            if tag == self.stop:
                raise ValueError(
                    f"outputs.{name} is {tag}, which is driver.stop: users set outputs, and the Robot Server "
                    "alone ends the motion; give the output another BOOL of RECEIVE"
                )
        return self


class KinematicDriver(DescriptionModel):
    """A robot that is no KUKA: the Robot Server itself keeps the time, and measured joints equal the setpoint."""

    kind: Literal["kinematic"]


Driver = Annotated[RsiDescription | KinematicDriver, Field(discriminator="kind")]


class ServoLag(DescriptionModel):
    """The drives' lag from command to motion, as the emulator models it: dead time and second order."""

    dead_time_s: NotNegative = 0.012
    natural_frequency_rad_s: Positive = 167.0
    damping: Positive = 1.0


class RobotDescription(DescriptionModel):
    """One robot of the cell."""

    model: str
    """A model's name (`kr16`), the path of a URDF file, or `package://` and a path within a package."""
    server: Endpoint
    """Where its Robot Server listens for SIM and HLI."""
    driver: Driver
    joints: dict[JointName, JointDescription]
    """In the joint order of the model."""
    locked_joints: dict[JointName, FiniteFloat] = {}
    """Joints that this cell holds still, for example a gripper's, and where: in rad or m, as in the URDF."""
    base: Pose = Pose()
    tool: Tool = Tool()
    hands: dict[Name, Hand] = {}
    """Of a robot with several; a single tool pose is that of the first. Such a robot has no `tool`."""
    camera: Camera | None = None
    attachments: dict[Name, Attachment] = {}
    mounted_on: tuple[str, ...] = ()
    """Bodies of the structure that the robot's base stands on or hangs from; never checked against it."""
    never_checked: tuple[tuple[str, str], ...] = ()
    """Links or bodies of the robot that cannot touch, or always do; `deltaq check` lists the pairs left out and why."""
    servo_lag: ServoLag = ServoLag()
    outputs: tuple[Name, ...] = ()
    inputs: tuple[Name, ...] = ()

    @model_validator(mode="after")
    def _has_a_tag_for_every_signal(self) -> Self:
        if isinstance(self.driver, RsiDescription):
            for kind, names in (("inputs", self.inputs), ("outputs", self.outputs)):
                tags: dict[str, str] = getattr(self.driver, kind)
                if set(names) != set(tags):
                    example = f"{next(iter(names), 'name')}: {'Di.I1' if kind == 'inputs' else 'Do.O1'}"
                    raise ValueError(
                        f"{kind} names {', '.join(names) or 'none'}, and driver.{kind} gives a TAG of the KRC's file "
                        f"for {', '.join(tags) or 'none'}; give one for each, such as {kind}: {{{example}}}"
                    )
        return self

    @model_validator(mode="after")
    def _carries_tools_in_one_place(self) -> Self:
        if self.hands and "tool" in self.model_fields_set:
            raise ValueError("a robot with hands carries its tools there: leave out tool")
        taken = {"tool", "camera"} & set(self.hands)
        if taken:
            raise ValueError(f"a hand cannot be named {' or '.join(sorted(taken))}; name it otherwise")
        return self

    def _vector(self, attribute: str) -> Array:
        vector = np.array([getattr(joint, attribute) for joint in self.joints.values()])
        vector.flags.writeable = False
        return vector

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(self.joints)

    @cached_property
    def units(self) -> tuple[Literal["rad", "m"], ...]:
        """Unit of each joint."""
        return tuple("rad" if joint.revolute else "m" for joint in self.joints.values())

    @cached_property
    def home(self) -> Array:
        """(n,) home configuration [rad or m]."""
        return self._vector("home")

    @cached_property
    def lower(self) -> Array:
        """(n,) lower limits [rad or m]."""
        return self._vector("lower")

    @cached_property
    def upper(self) -> Array:
        """(n,) upper limits [rad or m]."""
        return self._vector("upper")

    @cached_property
    def max_velocity(self) -> Array:
        """(n,) largest speeds [rad/s or m/s]."""
        return self._vector("max_velocity")

    @cached_property
    def max_acceleration(self) -> Array:
        """(n,) largest accelerations [rad/s^2 or m/s^2]."""
        return self._vector("max_acceleration")

    @cached_property
    def tracking_tolerance(self) -> Array:
        """(n,) how far measured joints may be off the commanded path [rad or m]."""
        return self._vector("tracking_tolerance")


class ContactDescription(DescriptionModel):
    """Bodies that may touch while an operator allows it, for example a gripper and its valve.

    Meanwhile the gate does not keep these pairs apart, and every robot that they belong to moves slowly.
    """

    bodies: Annotated[list[str], Field(min_length=1)]
    """Names of bodies of robots, such as gr/tool_finger_1."""
    against: Annotated[list[str], Field(min_length=1)]
    """Names of the bodies that they may touch, such as structure/valve_1."""
    speed: Annotated[float, Field(gt=0, le=1)] = 0.05
    """Fraction of the velocity limits that applies to the robots meanwhile."""

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Every body with every one that it may touch."""
        return [(one, other) for one in self.bodies for other in self.against]

    def concerns(self, robot: str) -> bool:
        """Whether a body of that robot is among them."""
        return any(name.startswith(f"{robot}/") for name in (*self.bodies, *self.against))


class GateDescription(DescriptionModel):
    """The margins of the gate.

    The timeouts only give a loss its name: the brake begins in the first cycle without a fresh admission.
    """

    stop_distance_m: Positive = 0.05
    """Bodies of different robots, and robot and structure, never come nearer than this."""
    self_stop_distance_m: Positive = 0.02
    """Two bodies of one robot never come nearer than this."""
    slow_down_distance_m: Positive | None = None
    """Below this distance, the nearer two bodies are, the slower they approach; none: no such limit."""
    slow_down_speed_m_s: Positive = 0.25
    """Approach speed that is allowed at that distance; it falls to zero at the stop distance."""
    servo_lag_s: Positive = 0.072
    """How long the drives may still travel setpoints that were sent before."""
    retreat_speed: Annotated[float, Field(gt=0, le=1)] = 0.1
    """Fraction of the velocity limits that is allowed while leaving a violation."""
    max_request_age_s: Positive = 0.12
    """An increment that answers an older state is stale, and one older than the table of topics allows."""
    gate_timeout_s: Positive = 0.5
    """Silence after which a Robot Server takes the gate for lost."""
    hli_timeout_s: Positive = 0.5
    """Silence after which the gate takes the HLI for lost."""
    krc_timeout_s: Positive = 0.25
    """Silence after which a Robot Server takes its KRC for lost."""

    @model_validator(mode="after")
    def _slows_down_before_it_stops(self) -> Self:
        stop = max(self.stop_distance_m, self.self_stop_distance_m)
        if self.slow_down_distance_m is not None and self.slow_down_distance_m <= stop:
            raise ValueError(
                f"slow_down_distance_m is {self.slow_down_distance_m:g}, which has to be more than the stop "
                f"distances, {stop:g}"
            )
        return self


class CellDescription(DescriptionModel):
    """A cell: its robots, its structure, the gate's margins, and where its services listen."""

    cell: Name
    cycle_s: Annotated[float, Field(ge=0.001, le=0.1)]
    """The robots' own sample time."""
    robots: Annotated[dict[Name, RobotDescription], Field(min_length=1, max_length=MOST_ROBOTS)]
    structure: dict[Name, Body] = {}
    gate: GateDescription = GateDescription()
    contacts: dict[Name, ContactDescription] = {}
    """Contacts that an operator may allow; none is allowed at the start."""
    hli: Endpoint = "tcp/127.0.0.1:7447"
    """Where the HLI serves zenoh clients."""
    sim: Endpoint = "tcp/127.0.0.1:7450"
    """Where the SIM listens in the guarded realm."""
    tcp_address: str = "127.0.0.1"
    tcp_port: Annotated[int, Field(ge=1, le=65535)] = 5210
    """Where the HLI serves JSON lines."""
    lease_s: Positive = 1.0
    """How long a lease lasts while its holder is silent; whatever the holder sends renews it."""
