"""Messages of the open realm: what a controller sends and sees.

All joint quantities are in the joint order of the robot's description, rad for revolute and m for
prismatic joints. `q` is a configuration, `dq` an increment over one cycle, never a velocity.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from deltaq_protocol.reasons import ReasonCode

PROTOCOL_VERSION = 3
LINE_VERSIONS = (1, 2, 3)
"""Versions that clients over lines of JSON may speak: to them later ones have only more fields to pass over."""

JointValue = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Joints = Annotated[tuple[JointValue, ...], Field(min_length=1, max_length=32)]
Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Quaternion = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
PoseRows = tuple[Row, Row, Row, Row]
"""A homogeneous matrix, row by row."""
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[a-z][a-z0-9_-]*$")]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Secret = Annotated[str | None, Field(repr=False)]
"""A token: neither shown nor quoted, see `deltaq_protocol.quoting`."""


class Message(BaseModel):
    """Base of all messages: immutable, and a field that is not known is an error.

    Neither its errors nor its `repr` show what may be a secret.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)


class Phase(StrEnum):
    """Phase of a robot; the transitions are a table in `deltaq_services.phases`."""

    OFFLINE = "offline"
    READY = "ready"
    ENGAGED = "engaged"
    BRAKING = "braking"
    HELD = "held"


class Outcome(StrEnum):
    """Outcome of an increment; `unknown` is never sent: a client uses it where no verdict came.

    `carried` has no cycle of its own: it came to the playout buffer after its turn, and its motion goes out with the
    increments behind it (`Playout`).
    """

    ADMITTED = "admitted"
    SCALED = "scaled"
    HELD = "held"
    REFUSED = "refused"
    UNKNOWN = "unknown"
    CARRIED = "carried"


class Sight(StrEnum):
    """How well a controller sees the robot that it follows: its view is as old as the link makes it, older, or gone."""

    FRESH = "fresh"
    STALE = "view_stale"
    LOST = "view_lost"


class Reason(Message):
    """One thing that limited a request: which limit, on what, the value requested and the bound (SI units)."""

    code: ReasonCode
    what: str = ""
    value: FiniteFloat | None = None
    bound: FiniteFloat | None = None


class ToolPose(Message):
    """Pose of the tool in the world: maps tool coordinates into world coordinates."""

    position: Vector3
    quaternion_wxyz: Quaternion


class Playout(Message):
    """The increments of a lease that wait for their turn in the HLI, so that each cycle has one though they jitter.

    An increment that answers cycle k is passed on with the state of cycle k + `delay_cycles`, which follows from how
    long those before it were under way. `waiting` have come before their turn. The setpoint of this state has in it all
    increments that answer a cycle up to `answered_cycle`, and none behind it; null before the first. `late` increments
    came when their turn was over; `empty` cycles had none and braked. Both count from the grant.

    `owed` is the motion of late ones that the setpoint does not have yet, less what the robot braked unasked in cycles
    that were empty; null if there is none. It goes out with the increments to come, over a few cycles, so that the `dq`
    of a verdict may have a part of it. An increment that is too late for that is refused as `late`.
    """

    delay_cycles: Count
    waiting: Count
    answered_cycle: Count | None = None
    late: Count = 0
    empty: Count = 0
    owed: Joints | None = None


CameraDistance = Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]
"""How far a camera may be asked to stand from its target [m]."""
TargetCoordinate = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
TargetPoint = tuple[TargetCoordinate, TargetCoordinate, TargetCoordinate]


class ViewWish(Message):
    """What a robot's camera is to look at, and from how far; whoever follows with it reads this from its states.

    The target is `aim_offset_m`, a point in the frame of the tool of `leader`, or `focus_m`, one that stands still in
    the world. What is null stays as the follower was started with.
    """

    distance_m: CameraDistance | None = None
    leader: Name | None = None
    aim_offset_m: TargetPoint | None = None
    focus_m: TargetPoint | None = None


class RobotState(Message):
    """State of one robot, published every cycle of its KRC.

    `q_cmd` is the setpoint just sent. In a cell with a lookahead an increment that answers this state goes into
    `setpoint_cycle`, and is added to `q_ahead`: the setpoint at the end of what has been admitted so far, and of the
    brake where nothing has. Both are null without a lookahead: it is the next cycle then, and `q_cmd`.
    `playout` is there where the robot's lease asked for it. `sight` is how well the controller sees what it follows, as
    its newest increment says; null if it says nothing. `view` is what its camera was asked to look at last; it outlives
    leases, so that the next follower looks there too.
    `gate` is the fingerprint of the gate that it passes: a hash of code and one of configuration; empty until
    the gate has been heard.
    """

    type: Literal["state"] = "state"
    robot: Name
    cycle: Count
    ipoc: Count
    time_s: FiniteFloat
    q: Joints
    q_cmd: Joints
    tool: ToolPose
    phase: Phase
    reason: ReasonCode | None = None
    gate: str = ""
    q_ahead: Joints | None = None
    setpoint_cycle: Count | None = None
    playout: Playout | None = None
    sight: Sight | None = None
    view: ViewWish | None = None


class Increment(Message):
    """A controller's request: move by `dq` in one cycle, in answer to the state of `cycle`.

    `lease` is never sent, and not read if it is: the server fills in whose increment it is. Over zenoh a proof shows it
    (`deltaq_protocol.proof`, with the token of the lease reply as the secret), over TCP the connection is the holder.
    `sight` is for people: states tell it, and nothing depends on it.
    """

    type: Literal["increment"] = "increment"
    robot: Name
    seq: Count
    cycle: Count
    dq: Joints
    lease: Secret = None
    sight: Sight | None = None


class Verdict(Message):
    """The gate's answer to one increment.

    `cycle` is that of the state that it was decided on; of an increment that was refused, the one that it answers.
    `setpoint_cycle` is the cycle that it goes into, the first whose setpoint has `dq` in it; null if it goes into
    none. Where its admission came too late for that cycle, the increment may be decided once more for the next one:
    another verdict on the same `seq` says so, and the last one counts.

    `dq` is what was admitted; `scale` is s in `dq(s) = (1 - s) * brake + s * request`. `clearance_m` is the distance of
    `pair`, the two bodies with the least distance beyond their stop distance at the middle of the tube.
    `time_to_stop_s` is the length of the brake behind `dq`.
    If the gate held or refused, `receipt` is the verdict's entry in the chain of refusals (`deltaq_protocol.receipts`).
    """

    type: Literal["verdict"] = "verdict"
    robot: Name
    cycle: Count
    seq: Count
    outcome: Outcome
    setpoint_cycle: Count | None = None
    scale: FiniteFloat = 0.0
    dq: tuple[FiniteFloat, ...] = ()
    time_to_stop_s: FiniteFloat | None = None
    reasons: tuple[Reason, ...] = ()
    clearance_m: FiniteFloat | None = None
    pair: tuple[str, str] | None = None
    receipt: str | None = None


class LeaseAction(StrEnum):
    """What can be done with the lease of a robot; `take` is a hand-over against the holder's will."""

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
    """Whether the lease was granted, who holds it now, and the token: the secret that its holder proves to have.

    The token comes once, to whoever it was granted to, and never over TCP.
    """

    type: Literal["lease"] = "lease"
    robot: Name
    granted: bool
    holder: str | None = None
    expires_s: FiniteFloat | None = None
    lease: Secret = None
    code: ReasonCode | None = None


class StopRequest(Message):
    """Bring every robot of the cell to rest; anyone may."""

    type: Literal["stop"] = "stop"
    client: str | None = Field(default=None, max_length=64)


class ResetRequest(Message):
    """Leave `held`; refused while the cause persists, and to others than the operator where the HLI knows one.

    `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["reset"] = "reset"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ViewRequest(ViewWish):
    """Ask whoever follows with a robot's camera for another view; states tell it (`RobotState.view`).

    What is null stays as it is. A `leader` or `aim_offset_m` ends an earlier `focus_m`. It needs the right to have a
    lease, and no lease: the follower holds it. `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["view"] = "view"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ViewReply(Message):
    """The view that is wished for now, all wishes together, and who holds the robot: null if nobody follows."""

    type: Literal["view"] = "view"
    robot: Name
    view: ViewWish
    holder: str | None = None


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


class ChallengeRequest(Message):
    """Ask for a challenge, which the operator's next request over zenoh answers."""

    type: Literal["challenge"] = "challenge"


class Challenge(Message):
    """A challenge: nonce of the proof beside one request of the operator, in hexadecimal digits; good once."""

    type: Literal["challenge"] = "challenge"
    challenge: Annotated[str, Field(max_length=128, pattern=r"^([0-9a-f]{2})+$", repr=False)]


class Done(Message):
    """A stop, a reset or a change of contacts was carried out.

    After a stop every robot is held, or offline; after a reset the robot is not held any more: its state has shown it.
    What is not confirmed in time is answered with an error, `unreachable`, that says so; it was asked for all the same.
    """

    type: Literal["done"] = "done"
    what: str


class IoRequest(Message):
    """Set digital outputs by name; the reply has all outputs and inputs.

    While a robot is leased only the holder sets its outputs; anybody may read. `lease` is never sent, as in
    `Increment`.
    """

    type: Literal["io"] = "io"
    robot: Name
    outputs: dict[str, bool] = Field(default_factory=dict, max_length=64)
    lease: Secret = None


class IoReply(Message):
    """Digital outputs and inputs of a robot."""

    type: Literal["io"] = "io"
    robot: Name
    outputs: dict[str, bool] = {}
    inputs: dict[str, bool] = {}


class Hello(Message):
    """First line of a TCP client."""

    type: Literal["hello"] = "hello"
    protocol: int
    client: str = Field(min_length=1, max_length=64)
    token: Secret = None


class DescribeRequest(Message):
    """Ask for the cell's description."""

    type: Literal["describe"] = "describe"


class RobotSummary(Message):
    """Summary of a robot for a controller: names, units and limits in joint order, SI units."""

    joints: tuple[str, ...]
    units: tuple[Literal["rad", "m"], ...]
    lower: Joints
    upper: Joints
    max_velocity: Joints
    max_acceleration: Joints
    max_increment: Joints


class Welcome(Message):
    """Answer to a hello."""

    type: Literal["welcome"] = "welcome"
    protocol: int = PROTOCOL_VERSION
    cell: str
    cycle_s: FiniteFloat
    robots: dict[str, RobotSummary]
    identity: str = ""


class JointPlacement(Message):
    """Where a joint is on what carries it: the pose of what it moves is `T_world_parent T_parent_joint motion(q)`.

    The motion is a turn by `q` about `axis`, or a displacement by `q` along it; the robot's summary tells by the unit
    which. `parent` is another joint's place in the order, from 0; a joint of parent -1 is placed in the world.
    """

    parent: int = Field(ge=-1)
    T_parent_joint: PoseRows
    axis: Vector3


class CarriedFrame(Message):
    """Where a frame is on the joint that carries it, by its place in the order from 0; of joint -1, in the world."""

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

    `kinematics` holds, by robot, what follows from both, for a client that reads neither. `hulls` holds what the gate
    takes the collision meshes of a URDF for: by robot and body, the corners of a convex hull in the frame of the body
    [m]. Visual meshes are not sent. `identity` is the cell's name and hash (`deltaq_protocol.identity`): one who has
    a file of the cell sees by it whether the same is meant.
    """

    type: Literal["description"] = "description"
    protocol: int = PROTOCOL_VERSION
    cell: str
    cycle_s: FiniteFloat
    robots: dict[str, RobotSummary]
    yaml: str
    urdf: dict[str, str]
    hulls: dict[str, dict[str, tuple[Vector3, ...]]] = {}
    kinematics: dict[str, RobotKinematics] = {}
    identity: str = ""


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


class NearestPair(Message):
    """Two bodies, their distance and the witness points in world coordinates [m]."""

    pair: tuple[str, str]
    distance_m: FiniteFloat
    points_m: tuple[Vector3, Vector3]


class Proximity(Message):
    """The nearest pairs of the cell, nearest first; published at a reduced rate."""

    type: Literal["proximity"] = "proximity"
    time_s: FiniteFloat
    pairs: tuple[NearestPair, ...]


class LeaseStatus(Message):
    """Who may write to a robot."""

    holder: str | None = None
    expires_s: FiniteFloat | None = None
    epoch: Count = 0


class RobotStatus(Message):
    """One robot as `deltaq status` shows it."""

    phase: Phase
    reason: ReasonCode | None
    cycle: Count
    state_age_s: FiniteFloat | None
    q: tuple[FiniteFloat, ...]
    lease: LeaseStatus
    counters: dict[str, int]


class Status(Message):
    """The running cell as `deltaq status` shows it.

    `contacts` are those that are allowed now; `lagging` says which streams are silent, or slower than the table of
    topics wants them. `identity` is the cell's name and hash, and `mismatches` tells which services have read another.
    """

    type: Literal["status"] = "status"
    cell: str
    protocol: int = PROTOCOL_VERSION
    robots: dict[str, RobotStatus]
    gate: dict[str, int]
    gate_age_s: FiniteFloat | None
    gate_fingerprint: str = ""
    contacts: tuple[str, ...] = ()
    hli: dict[str, int]
    nearest: NearestPair | None = None
    lagging: tuple[str, ...] = ()
    identity: str = ""
    mismatches: tuple[str, ...] = ()
