"""One robot of a cell."""

from __future__ import annotations

from functools import cached_property
from ipaddress import ip_address
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from deltaq_cell.description.bodies import (
    LOCAL,
    Attachment,
    Camera,
    DescriptionModel,
    ExchangeableTool,
    GuardedEndpointText,
    Hand,
    JointName,
    NotNegative,
    Pose,
    Positive,
    Tool,
    ToolChanger,
)
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Name

# One joint: its limits, and the part of them that the gate uses.


class JointDescription(DescriptionModel):
    """Limits and home of one joint; either all in degrees (revolute) or all in metres (prismatic)."""

    home_deg: FiniteFloat | None = None
    """Where `home` moves it to, and where an emulated robot begins."""
    lower_deg: FiniteFloat | None = None
    """Least setpoint that the gate admits."""
    upper_deg: FiniteFloat | None = None
    """Greatest setpoint that the gate admits."""
    max_velocity_deg_s: Positive | None = None
    """Greatest speed that the gate admits."""
    max_acceleration_rad_s2: Positive | None = None
    """Greatest acceleration, and the deceleration of the brake."""
    tracking_tolerance_deg: Positive = 0.1
    """How far the joint may be off the hull of its setpoints; the gate's distances contain it."""
    home_m: FiniteFloat | None = None
    lower_m: FiniteFloat | None = None
    upper_m: FiniteFloat | None = None
    max_velocity_m_s: Positive | None = None
    max_acceleration_m_s2: Positive | None = None
    tracking_tolerance_m: Positive = 0.0005

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
        unit = "deg" if given[0] else "m"
        home, lower, upper = (revolute if given[0] else prismatic)[:3]
        assert home is not None and lower is not None and upper is not None  # noqa: PT018 # a group is given
        if not lower < upper:
            raise ValueError(f"lower_{unit} {lower:g} must be below upper_{unit} {upper:g}")
        if not lower <= home <= upper:
            raise ValueError(
                f"home_{unit} {home:g} must lie between lower_{unit} {lower:g} and upper_{unit} {upper:g}"
            )
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


# How a Robot Server reaches its robot.


def _is_loopback(address: str) -> bool:
    try:
        return ip_address(address).is_loopback
    except ValueError:  # a name
        return address == "localhost"


class RsiDescription(DescriptionModel):
    """A KUKA controller reached over RSI: the Robot Server listens on `address:port`, the KRC sends to it."""

    kind: Literal["rsi"]
    address: str = "127.0.0.1"
    """Of this machine, towards the KRC."""
    port: Annotated[int, Field(ge=1, le=65535)]
    krc_address: str | None = None
    """The KRC's own address: datagrams from others are dropped. Needed unless `address` is a loopback."""
    ethernet_xml: str
    """The RSI configuration that the KRC has loaded, beside the cell's file or shipped."""
    krc: Literal["krc2", "krc4"] = "krc2"
    """Its generation."""
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
    """The emulator's operator panel listens here; a real KRC has none. Best a port that the system gives to no socket
    that asks for none: on Linux one below 32768."""

    @model_validator(mode="after")
    def _listens_to_one_krc(self) -> Self:
        if self.krc_address is None and not _is_loopback(self.address):
            raise ValueError(
                f"krc_address is not given though address is {self.address}: any host that "
                "reaches that address could pose as the KRC; give the KRC's own address, such as "
                "krc_address: 192.168.10.20"
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


DriverDescription = Annotated[RsiDescription | KinematicDriver, Field(discriminator="kind")]


class ServoLag(DescriptionModel):
    """The drives' lag from command to motion, as the emulator models it: dead time and second order."""

    dead_time_s: NotNegative = 0.012
    """From a setpoint's arrival at the drives to the first motion."""
    natural_frequency_rad_s: Positive = 167.0
    damping: Positive = 1.0


DRIVES = {
    "krc2": ServoLag(dead_time_s=0.046, natural_frequency_rad_s=40.0),
    "krc4": ServoLag(dead_time_s=0.016, natural_frequency_rad_s=40.0),
}
"""Lag of emulated drives by generation of the KRC, where a robot says none.

Of a KR 16 on a KR C2 a response of 50 ms and a tracking delay over RSI of 120 ms are published (Arbo, Eriksen,
Sanfilippo, Gravdahl: Comparison of KVP and RSI for controlling KUKA robots over ROS, IFAC-PapersOnLine 53-2, 2020,
9841-9846): two cycles of 12 ms until a setpoint reaches the drives, 46 ms of dead time, and a second order of 2 / 40 s.
For a KR C4 nothing is published: the same response, and a dead time of as many cycles, a stand-in until
`deltaq krc lag` has measured it."""


class RobotDescription(DescriptionModel):
    """One robot of the cell."""

    model: str
    """A model's name (`kr16`), the path of a URDF file, or `package://` and a path within a package."""
    server: GuardedEndpointText = LOCAL
    """Where its Robot Server listens for SIM and HLI: on this machine, or at `tls/HOST:PORT`."""
    driver: DriverDescription
    joints: Annotated[dict[JointName, JointDescription], Field(min_length=1)]
    """In the joint order of the model."""
    locked_joints: dict[JointName, FiniteFloat] = {}
    """Joints that this cell holds still, for example a gripper's, and where: in rad or m, as in the URDF."""
    base: Pose = Pose()
    """Of the robot's base in the world."""
    tool: Tool = Tool()
    """What the flange always carries, such as a tool changer; its frame is in use without an exchangeable tool."""
    tools: dict[Name, ExchangeableTool] = {}
    """Tools that its tool changer couples, frames and bodies in the flange frame."""
    tool_changer: ToolChanger | None = None
    hands: dict[Name, Hand] = {}
    """Of a robot with several; a single tool pose is that of the first. Such a robot has no `tool`."""
    camera: Camera | None = None
    attachments: dict[Name, Attachment] = {}
    """Bodies bolted to its links."""
    mounted_on: tuple[str, ...] = ()
    """Bodies of the structure that the robot's base stands on or hangs from; never checked against it."""
    never_checked: tuple[tuple[str, str], ...] = ()
    """Links or bodies of the robot that cannot touch, or always do; `deltaq check` lists the pairs left out and why."""
    servo_lag: ServoLag = ServoLag()
    """Lag of the emulated drives; of a robot on RSI that does not say it, that of its generation of KRC."""
    outputs: tuple[Name, ...] = ()
    """Digital outputs that users may switch."""
    inputs: tuple[Name, ...] = ()
    """Digital inputs that states show."""

    @model_validator(mode="after")
    def _lags_as_its_krc(self) -> Self:
        if isinstance(self.driver, RsiDescription) and "servo_lag" not in self.model_fields_set:
            self.__dict__["servo_lag"] = DRIVES[self.driver.krc]  # no field of a frozen model can be set
        return self

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
        taken = {"tool", "camera", "object"} & set(self.hands)
        if taken:
            raise ValueError(f"a hand cannot be named {' or '.join(sorted(taken))}; name it otherwise")
        return self

    @model_validator(mode="after")
    def _can_change_its_tools(self) -> Self:
        changer = self.tool_changer
        if (changer is None) == bool(self.tools):
            missing = "tool_changer" if self.tools else "tools"
            raise ValueError(f"tools and tool_changer are given together; {missing} is missing")
        if changer is None:
            return self
        if self.hands or not isinstance(self.driver, RsiDescription):
            raise ValueError(
                "tool_changer: for a robot on RSI with a single tool, since its signals switch it"
            )
        for field, name, known in (
            ("release", changer.release, self.outputs),
            ("locked", changer.locked, self.inputs),
        ):
            if name not in known:
                has = ", ".join(known) or "none"
                raise ValueError(f"tool_changer.{field} is {name!r}, no such signal; the robot has {has}")
        if taken := {"tool", "camera", "object"} & set(self.tools):
            raise ValueError(f"a tool cannot be named {' or '.join(sorted(taken))}; name it otherwise")
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
