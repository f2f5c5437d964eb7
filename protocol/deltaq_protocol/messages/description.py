"""What a client is told first: the cell and its robots."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.messages.base import PROTOCOL_VERSION, Joints, Message, PoseRows, Real, Secret, Vector3


class Hello(Message):
    """The name and role of a TCP client; only a `challenge` and a stop may come before it.

    `proof` proves a token without sending it: HMAC-SHA256 with the token over `deltaq hello ` and `challenge`, in
    hexadecimal digits. The server gave the challenge, on this connection or another. Over TLS `token` does as well.
    """

    type: Literal["hello"] = "hello"
    protocol: int
    client: str = Field(min_length=1, max_length=64)
    token: Secret = None
    challenge: Annotated[str | None, Field(max_length=128, pattern=r"^([0-9a-f]{2})+$", repr=False)] = None
    proof: Annotated[str | None, Field(pattern=r"^[0-9a-f]{64}$", repr=False)] = None


class DescribeRequest(Message):
    """Ask for the cell's description."""

    type: Literal["describe"] = "describe"


class RobotSummary(Message):
    """Summary of a robot for a controller: names, units, limits and home in joint order, SI units."""

    joints: tuple[str, ...]
    units: tuple[Literal["rad", "m"], ...]
    lower: Joints
    upper: Joints
    max_velocity: Joints
    max_acceleration: Joints
    max_increment: Joints
    home: Joints = ()


class Welcome(Message):
    """Answer to a hello."""

    type: Literal["welcome"] = "welcome"
    protocol: int = PROTOCOL_VERSION
    cell: str
    cycle_s: Real
    robots: dict[str, RobotSummary]
    identity: str = ""


class JointPlacement(Message):
    """The placement of a joint on its parent: the pose of the moved link is `T_world_parent T_parent_joint motion(q)`.

    The motion is a rotation by `q` about `axis`, or a displacement by `q` along it; the unit in the robot's summary
    says which. `parent` is the index of another joint in the order, from 0; a joint of parent -1 is placed in the
    world.
    """

    parent: int = Field(ge=-1)
    T_parent_joint: PoseRows
    axis: Vector3


class CarriedFrame(Message):
    """Pose of a frame in its parent joint. Joints are numbered from 0; -1 is the world."""

    joint: int = Field(ge=-1)
    T_joint_frame: PoseRows


class RobotKinematics(Message):
    """A robot's kinematics in joint order, and what it carries: `tool`, `camera` if it has one, and its hands.

    A camera looks along its z axis, and its x axis points up in the picture.
    """

    joints: tuple[JointPlacement, ...]
    frames: dict[str, CarriedFrame]


class Description(Message):
    """Everything a client needs to model the cell: the YAML text, each robot's URDF text, and its hulls.

    `kinematics` holds, by robot, what follows from YAML and URDF, for a client that reads neither. `hulls` holds the
    hulls by which the gate replaces the collision meshes of a URDF: by robot and body, the corners of a convex hull in
    the frame of the body [m]. Visual meshes are not sent. `identity` is the cell's name and hash
    (`deltaq_protocol.identity`); a client that has a file of the cell compares it with its own.
    """

    type: Literal["description"] = "description"
    protocol: int = PROTOCOL_VERSION
    cell: str
    cycle_s: Real
    robots: dict[str, RobotSummary]
    yaml: str
    urdf: dict[str, str]
    hulls: dict[str, dict[str, tuple[Vector3, ...]]] = {}
    kinematics: dict[str, RobotKinematics] = {}
    identity: str = ""
