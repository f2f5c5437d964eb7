"""Messages of motion: increments, verdicts, states."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.messages.base import (
    Count,
    Joints,
    Message,
    Name,
    Quaternion,
    Real,
    Secret,
    ToolName,
    Vector3,
)
from deltaq_protocol.reasons import ReasonCode

# The requested view of a camera; the robot's states publish it for the controller that follows with the camera.

CameraDistance = Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]
"""How far a camera may be asked to stand from its target [m]."""
TargetCoordinate = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
TargetPoint = tuple[TargetCoordinate, TargetCoordinate, TargetCoordinate]


MOST_TARGETS = 8
"""Targets that a camera may be given at once."""


class Sight(StrEnum):
    """How well a controller sees its target.

    Its data of the followed robot are fresh, too old or missing; or a body hides the target from the camera; or limits
    or bodies keep the camera from the distance or direction that it is asked for.
    """

    FRESH = "fresh"
    STALE = "view_stale"
    LOST = "view_lost"
    HIDDEN = "view_hidden"
    OUT_OF_REACH = "view_out_of_reach"


AIM_M: TargetPoint = (0.0, 0.0, 0.04)
"""Point of a tool that is looked at where none is named, in the tool's frame [m].

It lies before the fingers of a gripper: there the work is, and the fingers do not hide it.
"""


class ViewTarget(Message):
    """One thing to look at: a point of the tool of `leader`, or `focus_m`, a fixed point in the world.

    `aim_offset_m` is that point in the frame of the tool; null is [0, 0, 0.04], before the fingers of a gripper.
    """

    leader: Name | None = None
    aim_offset_m: TargetPoint | None = None
    focus_m: TargetPoint | None = None

    def words(self) -> str:
        """The target as text, in the form of `deltaq camera view --target`."""
        if self.focus_m is not None:
            return _coordinates(self.focus_m)
        name = self.leader or ""
        return name if self.aim_offset_m is None else f"{name}:{_coordinates(self.aim_offset_m)}"


class ViewWish(Message):
    """Requested target and distance of a robot's camera; the controller that follows with it reads them in its states.

    The target is `aim_offset_m`, a point in the frame of the tool of `leader`, or `focus_m`, a fixed point in the
    world. A null value leaves the value with which the follower was started. With `targets`, the most important one
    first, the camera looks at the first that it can see, and the three above are null.
    """

    distance_m: CameraDistance | None = None
    leader: Name | None = None
    aim_offset_m: TargetPoint | None = None
    focus_m: TargetPoint | None = None
    targets: Annotated[tuple[ViewTarget, ...], Field(min_length=1, max_length=MOST_TARGETS)] | None = None


class ViewRequest(ViewWish):
    """Ask the controller that follows with a robot's camera for another view; states publish it (`RobotState.view`).

    A null value changes nothing. A `leader` or `aim_offset_m` ends an earlier `focus_m`, each of the three ends earlier
    `targets`, and `targets` end all three. The request needs the right to have a lease, but not the lease itself, which
    the follower holds. `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["view"] = "view"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ViewReply(Message):
    """The view that results from all requests so far, and the holder of the robot: null if no client follows.

    `sight` and `target` are as in the robot's states: how well the camera sees its target, and the target's name.
    """

    type: Literal["view"] = "view"
    robot: Name
    view: ViewWish
    holder: str | None = None
    sight: Sight | None = None
    target: ViewTarget | None = None


def _coordinates(point: TargetPoint) -> str:
    return ",".join(f"{coordinate:g}" for coordinate in point)


class Phase(StrEnum):
    """Phase of a robot; the transitions are a table in `deltaq_services.phases`."""

    OFFLINE = "offline"
    READY = "ready"
    ENGAGED = "engaged"
    BRAKING = "braking"
    HELD = "held"


class Outcome(StrEnum):
    """Outcome of an increment; `unknown` is never sent: a client uses it where no verdict came.

    `carried` has no cycle of its own: it came to the jitter buffer after its turn, and its motion goes out with the
    increments behind it (`Playout`).
    """

    ADMITTED = "admitted"
    SCALED = "scaled"
    HELD = "held"
    REFUSED = "refused"
    UNKNOWN = "unknown"
    CARRIED = "carried"


class Reason(Message):
    """One thing that limited a request: which limit, on what, the value requested and the bound (SI units)."""

    code: ReasonCode
    what: str = ""
    value: Real | None = None
    bound: Real | None = None


class ToolPose(Message):
    """Pose of the tool in the world: maps tool coordinates into world coordinates."""

    position: Vector3
    quaternion_wxyz: Quaternion


class Playout(Message):
    """The jitter buffer of a lease: increments wait in the HLI, so that each cycle has one.

    The HLI passes an increment that answers cycle k on with the state of cycle k + `delay_cycles`. The delay follows
    from the travel times of earlier increments. `waiting` increments have come early. The setpoint of this state
    includes all increments that answer cycles up to `answered_cycle`, and no later ones; null before the first. `late`
    increments missed their cycle, and `empty` cycles had no increment and braked. Both count from the grant.

    `owed` is deferred motion: that of late increments, less the motion of the brake in empty cycles; null if there is
    none. Increments of the next cycles carry it out, so the `dq` of a verdict may include a part of it. An increment
    that is too late for that is refused as `late`.

    `planned` are the increments whose turns are the next cycles, up to the first cycle without one: where the robot
    goes if the gate admits them.
    """

    delay_cycles: Count
    waiting: Count
    answered_cycle: Count | None = None
    late: Count = 0
    empty: Count = 0
    owed: Joints | None = None
    planned: tuple[Joints, ...] = ()


class RobotState(Message):
    """State of one robot, published every cycle of its KRC.

    `q_cmd` is the setpoint just sent. In a cell with a lookahead an increment that answers this state goes into
    `setpoint_cycle`, and is added to `q_ahead`: the setpoint after all increments admitted so far, and after the
    brake in cycles without one. Without a lookahead both are null; they are then the next cycle and `q_cmd`.
    `playout` is present if the robot's lease asked for a jitter buffer. `sight` is how well the controller sees its
    target, and `target` is that target's name, both from its newest increment; null if the increment has none. `view`
    is the view last requested of its camera; it outlives leases, so that the next follower uses the same view. `gate`
    is the fingerprint of the gate: a hash of its code and one of its configuration; empty until the gate's first
    message. `coupled` is the exchangeable tool whose frame `tool` is; empty: none; null: it is not known, or the robot
    has no tool changer.
    """

    type: Literal["state"] = "state"
    robot: Name
    cycle: Count
    ipoc: Count
    time_s: Real
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
    target: ViewTarget | None = None
    view: ViewWish | None = None
    coupled: ToolName | None = None


MOST_EARLIER = 4
"""Increments that one may repeat."""


class EarlierIncrement(Message):
    """A repetition of an earlier increment, which may have been lost."""

    seq: Count
    cycle: Count
    dq: Joints


class Increment(Message):
    """A controller's request: move by `dq` in one cycle, in answer to the state of `cycle`.

    `lease` is never sent, and is ignored if it is: the server fills in the lease. Over zenoh a proof shows the lease
    (`deltaq_protocol.proof`, with the token of the lease reply as the secret); over TCP the connection is the holder.
    `sight` and `target` are information: states repeat them, and no decision depends on them. `earlier` has the
    increments sent just before, the oldest first, for a link that loses messages. One of them is used if the lease
    has a jitter buffer and it has not come itself; without a jitter buffer they are ignored.
    """

    type: Literal["increment"] = "increment"
    robot: Name
    seq: Count
    cycle: Count
    dq: Joints
    lease: Secret = None
    sight: Sight | None = None
    target: ViewTarget | None = None
    earlier: Annotated[tuple[EarlierIncrement, ...], Field(max_length=MOST_EARLIER)] = ()


class Verdict(Message):
    """The gate's answer to one increment.

    `cycle` is that of the state on which the increment was decided; for a refused increment, of the state that it
    answers. `setpoint_cycle` is the cycle that the increment goes into, the first whose setpoint includes `dq`; null
    if it goes into none. If its admission came too late for that cycle, the increment may be decided once more for
    the next one: another verdict on the same `seq` says so, and the last one counts.

    `dq` is what was admitted; `scale` is s in `dq(s) = (1 - s) * brake + s * request`. `clearance_m` is the distance
    of `pair`, the two bodies with the least distance beyond their stop distance at the middle of the tube.
    `time_to_stop_s` is the length of the brake behind `dq`. If the gate held or refused, `receipt` is the verdict's
    entry in the chain of refusals (`deltaq_protocol.receipts`).
    """

    type: Literal["verdict"] = "verdict"
    robot: Name
    cycle: Count
    seq: Count
    outcome: Outcome
    setpoint_cycle: Count | None = None
    scale: Real = 0.0
    dq: tuple[Real, ...] = ()
    time_to_stop_s: Real | None = None
    reasons: tuple[Reason, ...] = ()
    clearance_m: Real | None = None
    pair: tuple[str, str] | None = None
    receipt: str | None = None
