"""Requests of clients and their answers: description of the cell, leases, outputs, stop and reset, status."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.messages.base import (
    PROTOCOL_VERSION,
    Count,
    Joints,
    Message,
    Name,
    PoseRows,
    Real,
    Secret,
    ToolName,
    Vector3,
)
from deltaq_protocol.messages.motion import Phase, Verdict
from deltaq_protocol.reasons import ReasonCode

# The first message to a client: the cell and its robots.


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

    `kinematics` holds the kinematics by robot, computed from YAML and URDF, for clients that read neither. `hulls`
    holds the convex hulls that the gate uses in place of the collision meshes of a URDF: by robot and body, the
    corners of a convex hull in the frame of the body [m]. Visual meshes are not sent. `identity` is the cell's name
    and hash (`deltaq_protocol.identity`); a client that has a file of the cell compares it with its own. `coupled` is
    as in the states of the robots with a tool changer.
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
    coupled: dict[Name, ToolName | None] = {}


# Leases: the right to move a robot.


class LeaseAction(StrEnum):
    """Actions on the lease of a robot; `take` is a hand-over against the holder's will."""

    ACQUIRE = "acquire"
    RENEW = "renew"
    RELEASE = "release"
    TAKE = "take"


class LeaseRequest(Message):
    """Ask for the right to write to a robot: one writer a robot, any number of readers.

    `take` needs the operator where the HLI has been given the operator's token. `token` and `lease` are never sent, and
    not read if they are: over zenoh proofs stand for them (`deltaq_protocol.proof`), over TCP the hello and the
    connection.

    `playout` is for a controller that is far away: increments wait for their turn (`Playout`).
    """

    type: Literal["lease"] = "lease"
    robot: Name
    action: LeaseAction
    playout: bool = False
    client: str | None = Field(default=None, max_length=64)
    lease: Secret = None
    token: Secret = None


class LeaseReply(Message):
    """Whether the lease was granted, its present holder, and the token: the secret that the holder proves to have.

    The token comes once, to the client that was granted the lease, and never over TCP.
    """

    type: Literal["lease"] = "lease"
    robot: Name
    granted: bool
    holder: str | None = None
    expires_s: Real | None = None
    lease: Secret = None
    code: ReasonCode | None = None


class StopRequest(Message):
    """Bring every robot of the cell to rest; anyone may."""

    type: Literal["stop"] = "stop"
    client: str | None = Field(default=None, max_length=64)


class ResetRequest(Message):
    """End the hold of a robot; refused while its cause persists.

    If the HLI has an operator's token, only operators may.

    `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["reset"] = "reset"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class DryRunRequest(Message):
    """Ask for the gate's verdict on an increment if it came now; nothing moves, and no lease is needed."""

    type: Literal["dry_run"] = "dry_run"
    robot: Name
    dq: Joints


class DryRunReply(Message):
    """The verdict that the gate would have given; its `seq` is 0."""

    type: Literal["dry_run"] = "dry_run"
    robot: Name
    verdict: Verdict


class ContactRequest(Message):
    """Let bodies touch that a contact of the cell names, or forbid it again; an operator's privilege.

    `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["contact"] = "contact"
    contact: Name
    allowed: bool
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ToolRequest(Message):
    """Couple the tool in front of the robot's tool changer, or release the present one, with an empty `tool`.

    Only the holder of the lease may. After the answer, `coupled` in the robot's states changes once the changer's input
    has confirmed it. `lease` is never sent, as in `Increment`.
    """

    type: Literal["tool"] = "tool"
    robot: Name
    tool: ToolName
    lease: Secret = None


class ChallengeRequest(Message):
    """Ask for a challenge, which the operator's next request over zenoh answers, or the hello of a TCP client."""

    type: Literal["challenge"] = "challenge"


class Challenge(Message):
    """Nonce of the proof beside a request of the operator, or in a hello, in hexadecimal digits; good once."""

    type: Literal["challenge"] = "challenge"
    challenge: Annotated[str, Field(max_length=128, pattern=r"^([0-9a-f]{2})+$", repr=False)]


class Done(Message):
    """A stop, a reset, a change of contacts or the switching of a tool changer was carried out.

    After a stop every robot is held, or offline; after a reset the robot is not held any more: its state has shown it.
    Without confirmation in time the answer is the error `unreachable`, although the gate was asked.
    """

    type: Literal["done"] = "done"
    what: str


class IoRequest(Message):
    """Set digital outputs by name; the reply has all outputs and inputs.

    While a robot is leased only the holder sets its outputs; anybody may read. `lease` is never sent, as in
    `Increment`. The holder's `note` says what it does; the audit log and recordings keep it.
    """

    type: Literal["io"] = "io"
    robot: Name
    outputs: dict[str, bool] = Field(default_factory=dict, max_length=64)
    note: Annotated[str, Field(max_length=300)] = ""
    lease: Secret = None


class IoReply(Message):
    """Digital outputs and inputs of a robot."""

    type: Literal["io"] = "io"
    robot: Name
    outputs: dict[str, bool] = {}
    inputs: dict[str, bool] = {}


class Error(Message):
    """A message that could not be served, and why.

    `request` is the type of the message that it answers; `robot` and `seq` are that message's, as far as it had any.
    An error that answers no message, such as the loss of a lease, has no `request`.
    """

    type: Literal["error"] = "error"
    code: ReasonCode
    message: str
    hint: str = ""
    request: str | None = None
    robot: str | None = None
    seq: int | None = None


# The running cell.


class NearestPair(Message):
    """Two bodies, their distance and the witness points in world coordinates [m]."""

    pair: tuple[str, str]
    distance_m: Real
    points_m: tuple[Vector3, Vector3]


class Proximity(Message):
    """The nearest pairs of the cell, nearest first; published at a reduced rate."""

    type: Literal["proximity"] = "proximity"
    time_s: Real
    pairs: tuple[NearestPair, ...]


class LeaseStatus(Message):
    """The holder of a robot's lease."""

    holder: str | None = None
    expires_s: Real | None = None
    epoch: Count = 0


class RobotStatus(Message):
    """One robot as `deltaq status` shows it; `lag_s` is the measured lag of each axis, null where it is not known."""

    phase: Phase
    reason: ReasonCode | None
    cycle: Count
    state_age_s: Real | None
    q: tuple[Real, ...]
    lease: LeaseStatus
    counters: dict[str, Count]
    lag_s: tuple[Real | None, ...] = ()


class Status(Message):
    """The running cell as `deltaq status` shows it.

    `contacts` has the contacts that are allowed now; `lagging` names the streams that are silent, or slower than the
    table of topics requires. `identity` is the cell's name and hash, and `mismatches` names the services that have read
    another cell.
    """

    type: Literal["status"] = "status"
    cell: str
    protocol: int = PROTOCOL_VERSION
    robots: dict[str, RobotStatus]
    gate: dict[str, Count]
    gate_age_s: Real | None
    gate_fingerprint: str = ""
    contacts: tuple[str, ...] = ()
    hli: dict[str, Count]
    nearest: NearestPair | None = None
    lagging: tuple[str, ...] = ()
    identity: str = ""
    mismatches: tuple[str, ...] = ()
