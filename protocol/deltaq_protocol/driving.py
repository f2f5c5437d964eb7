"""Lines between whoever watches over an operator and the process that drives a robot for that operator.

One JSON object a line: requests on the driver's standard input, reports and answers on its standard output. A request
with an `id` gets one `Answer`. The end of the input is a request too: come to rest, release the robot, end.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from deltaq_protocol.messages import JointValue, Message

WISH_S = 0.25
"""A wish ends by itself after this, unless the next one renews it [s]."""

RequestId = Annotated[str, Field(min_length=1, max_length=64)]


class DrivingMode(StrEnum):
    """How a robot is driven: the teleoperator's modes, and following with the camera."""

    JOINT = "joint"
    DECOUPLED = "decoupled"
    SELF_MOTION = "self-motion"
    ADVISOR = "advisor"
    COUPLED = "coupled"
    FOLLOW = "follow"


Axes = Literal["world", "tool"]
"""In which hands are moved."""


class Take(Message):
    """Take the robot's lease for a client of that name."""

    type: Literal["take"] = "take"
    id: RequestId
    client: Annotated[str, Field(min_length=1, max_length=64)]


class Release(Message):
    """Bring the robot to rest and release it; answered when that is done."""

    type: Literal["release"] = "release"
    id: RequestId


class ChangeMode(Message):
    """Drive in this mode from now on; the robot comes to rest in the one before."""

    type: Literal["mode"] = "mode"
    id: RequestId
    mode: DrivingMode
    frame: Axes = "world"


class Wish(Message):
    """A wish to move, good for `WISH_S`; an empty one is rest.

    `joints` has a speed for each joint, (n,) [rad/s or m/s]. `twist` moves `hand`: three linear [m/s] and three
    angular [rad/s] in the mode's axes; without a `hand`, all hands. `option` is the advisor's option to go to.
    """

    type: Literal["wish"] = "wish"
    joints: Annotated[tuple[JointValue, ...], Field(max_length=32)] = ()
    twist: tuple[JointValue, JointValue, JointValue, JointValue, JointValue, JointValue] | None = None
    hand: Annotated[str, Field(max_length=64)] = ""
    option: Annotated[int, Field(ge=1, le=99)] | None = None


class ViewAt(Message):
    """The distance that a follower keeps from its focus [m]."""

    type: Literal["view_at"] = "view_at"
    id: RequestId
    distance_m: Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]


class Switch(Message):
    """Switch digital outputs, by name."""

    type: Literal["switch"] = "switch"
    id: RequestId
    outputs: Annotated[dict[str, bool], Field(max_length=64)]


DriverRequest = Take | Release | ChangeMode | Wish | ViewAt | Switch
REQUESTS: TypeAdapter[DriverRequest] = TypeAdapter(Annotated[DriverRequest, Field(discriminator="type")])


class DriverAnswer(Message):
    """What became of the request `id`; `text` says why not, if it was not done."""

    type: Literal["answer"] = "answer"
    id: str
    done: bool
    text: str = ""


class DriverStage(StrEnum):
    """How far the driver is."""

    STARTING = "starting"
    FREE = "free"
    LEASED = "leased"


class DriverReport(Message):
    """How the driver is doing, some times a second while it changes.

    `limit` says what limits the operator now, `doing` what the mode is about, both in words. `longest_cycle_s` is the
    longest time from a state to its verdict since the report before [s].
    """

    type: Literal["report"] = "report"
    stage: DriverStage
    mode: DrivingMode
    frame: Axes = "world"
    limit: str = ""
    doing: str = ""
    distance_m: FiniteFloat | None = None
    longest_cycle_s: FiniteFloat | None = None


DriverMessage = DriverAnswer | DriverReport
SAID: TypeAdapter[DriverMessage] = TypeAdapter(Annotated[DriverMessage, Field(discriminator="type")])
