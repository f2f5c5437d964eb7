"""Messages from browsers to the console, as JSON.

Times named `_ms` are milliseconds of the sender's clock; all else is in SI units. A command is answered
with one `ack` that carries its `id`.
`deltaq_services.console.client` defines when a command expires.
"""

import json
from enum import StrEnum
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from deltaq_protocol import driving
from deltaq_protocol.codec import place, shown
from deltaq_protocol.driving import DrivingMode, Frame, Grip, StepCycles
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.messages import Joints, JointValue, Message, Name, Real
from deltaq_protocol.messages.motion import MOST_TARGETS

MAX_MESSAGE_BYTES = 4096
"""Longest message that a browser may send."""
MOST_MESSAGES_S = 120.0
"""Messages that a browser may send in a second; `stop` is not counted among them."""

_MOTION_S, _OTHER_S = 0.5, 2.0
EXPIRY_S = {
    "lease": _OTHER_S,
    "reset": _OTHER_S,
    "mode": _MOTION_S,
    "choose_master": _MOTION_S,
    "jog": _MOTION_S,
    "view_distance": _MOTION_S,
    "look_at": _MOTION_S,
    "output": _MOTION_S,
    "dry_run": _OTHER_S,
    "advise": _OTHER_S,
    "reach": _OTHER_S,
    "reach_joints": _OTHER_S,
    "routine": _OTHER_S,
    "record": _OTHER_S,
    "replay": _OTHER_S,
}
"""How late a command may come, by its type [s]: later it is not carried out. A stop is, whenever it comes."""

ALL_HANDS = "*"
"""In the place of a hand's name: all hands of the robot, or the object between them."""

_BOUNDS = ("gt", "ge", "lt", "le", "min_length", "max_length", "expected", "expected_tags", "pattern")

CommandId = Annotated[str, Field(min_length=1, max_length=64)]


class ConsoleCommand(Message):
    """Base of messages from a browser."""

    id: CommandId
    sent_ms: Real


class Ping(ConsoleCommand):
    """Measures the clocks; answered with a `Pong`, not with an `Ack`. To be sent once a second or more often."""

    type: Literal["ping"]


class Stop(ConsoleCommand):
    """Bring every robot to rest. It never expires, observers may send it, and it needs no field but its type."""

    type: Literal["stop"]
    id: Annotated[str, Field(max_length=64)] = ""
    sent_ms: Real = 0.0


class Reset(ConsoleCommand):
    """End the hold of a robot."""

    type: Literal["reset"]
    robot: Name


class LeaseVerb(StrEnum):
    """Actions on a robot's lease: `ask` the holder, who answers with `grant` or `refuse`.

    A holder outside this console cannot be asked; `take_over` takes the lease from it.
    """

    TAKE = "take"
    RELEASE = "release"
    ASK = "ask"
    GRANT = "grant"
    REFUSE = "refuse"
    TAKE_OVER = "take_over"


class LeaseCommand(ConsoleCommand):
    """Take a robot's lease, give it back, or hand it over."""

    type: Literal["lease"]
    robot: Name
    action: LeaseVerb


class SetMode(ConsoleCommand):
    """How the robot is driven from now on, in which axes hands are moved, and whether they hold an object.

    Without a `grip` that stays as it was.
    """

    type: Literal["mode"]
    robot: Name
    mode: DrivingMode
    frame: Frame = Frame.WORLD
    grip: Grip | None = None


class SetMaster(ConsoleCommand, driving.ChooseMaster):
    """Choose another robot of the cell, whose tool leads a hand while a `Jog` has `led`."""

    robot: Name


class Jog(ConsoleCommand):
    """A motion command; it ends after 0.25 s unless the next one renews it.

    Without `hand` it is a speed for each joint, (n,) [rad/s or m/s]; with it a twist of that end effector, (6,):
    three linear [m/s] and three angular [rad/s] in the axes of the mode's frame. A `hand` of `*` is all of them, or
    the object between them. `led`: the master leads that end effector instead. `option` is the rank of a path whose
    button is held down. `cycles` makes the command a step of so many cycles of the robot, which is not renewed.
    """

    type: Literal["jog"]
    robot: Name
    wish: Annotated[tuple[JointValue, ...], Field(max_length=32)] = ()
    hand: Annotated[str, Field(max_length=64)] = ""
    led: bool = False
    option: Annotated[int, Field(ge=1, le=99)] | None = None
    cycles: StepCycles | None = None


class ViewDistance(ConsoleCommand):
    """The distance that a follower keeps from its focus [m]."""

    type: Literal["view_distance"]
    robot: Name
    value_m: Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]


class LookAt(ConsoleCommand):
    """Robots whose tools a follower is to look at, the most important first: it looks at the first that it can see."""

    type: Literal["look_at"]
    robot: Name
    targets: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MOST_TARGETS)]


class SetOutput(ConsoleCommand):
    """Switch a digital output, by its place in the robot's `outputs`."""

    type: Literal["output"]
    robot: Name
    index: Annotated[int, Field(ge=0, le=63)]
    value: bool


class AskAdvisor(ConsoleCommand, driving.Advise):
    """Look for options, or end the search and forget the choice."""

    robot: Name


class DragPose(ConsoleCommand, driving.Reach):
    """Plan the path of a hand to a pose in the world."""

    robot: Name


class DragJoints(ConsoleCommand, driving.ReachJoints):
    """Plan the path to a configuration."""

    robot: Name


class AskRoutine(ConsoleCommand, driving.DoRoutine):
    """Plan a routine, run it, pause it, go on with it, or give it up."""

    robot: Name


class DryRun(ConsoleCommand):
    """The gate's verdict on an increment (n,) in the present state [rad or m]; nothing moves."""

    type: Literal["dry_run"]
    robot: Name
    dq: Joints


class Record(ConsoleCommand):
    """Begin to record the cell to a new file in the console's folder, or end it."""

    type: Literal["record"]
    action: Literal["start", "stop"]


class ReplayShown(ConsoleCommand):
    """Whether this browser shows a recording: while it does, it commands nothing but a stop."""

    type: Literal["replay"]
    shown: bool


PassedOn = SetMaster | AskAdvisor | DragPose | DragJoints | AskRoutine
"""Requests of a robot's driver, as a browser sends them."""
DriverCommand = SetMode | SetOutput | PassedOn
"""What a robot's driver is asked to do."""
ViewCommand = ViewDistance | LookAt
RobotCommand = Reset | LeaseCommand | ViewCommand | Jog | DryRun | DriverCommand
AnyCommand = Ping | Stop | Record | ReplayShown | RobotCommand
COMMANDS: TypeAdapter[AnyCommand] = TypeAdapter(Annotated[AnyCommand, Field(discriminator="type")])


class InvalidCommandError(ProtocolError):
    """A message that is not a valid command; the text names field, value and bound.

    Attributes:
        id: of the command, as far as it had one.
    """

    def __init__(self, text: str, command_id: str = "") -> None:
        super().__init__(text)
        self.id = command_id


def command_of(message: str | bytes) -> AnyCommand:
    """The command in a message.

    Raises:
        InvalidCommandError: there is none in it.
    """
    if isinstance(message, bytes):
        raise InvalidCommandError(f"message: must be text, got {len(message)} bytes")
    # a browser may send half a surrogate pair, which is no text
    length = len(message.encode(errors="replace"))
    if length > MAX_MESSAGE_BYTES:
        raise InvalidCommandError(f"message: {length} bytes long, at most {MAX_MESSAGE_BYTES} are allowed")
    try:
        return COMMANDS.validate_json(message)
    except ValidationError as error:
        raise InvalidCommandError(_words(dict(error.errors(include_url=False)[0])), id_in(message)) from None
    except UnicodeEncodeError:
        raise InvalidCommandError("message: is not UTF-8 text") from None


def _words(error: dict[str, Any]) -> str:
    # the first part of a place is the kind of the command
    field = place(error["loc"][1:]) or place(error["loc"])
    context = error.get("ctx", {})
    if error["type"].startswith("union_tag"):
        field = "type"
    elif error["type"] == "missing":
        return f"{field}: is missing"
    elif error["type"] == "extra_forbidden":
        return f"{field}: is not a field of a {error['loc'][0]}"
    bound = next((context[name] for name in _BOUNDS if name in context), None)
    given = error["input"]
    if field == "type" and isinstance(given, dict):
        given = given.get("type")
    text = f"{field or 'message'}: {error['msg'].removeprefix('Input ')}, got {shown(given)}"
    return text if bound is None or error["type"].endswith("tag_invalid") else f"{text}; bound {bound}"


def id_in(message: str | bytes) -> str:
    """The id in a message, as far as it has one."""
    try:
        data = json.loads(message)
    except (ValueError, RecursionError):
        return ""
    command_id = data.get("id") if isinstance(data, dict) else None
    return command_id if isinstance(command_id, str) and 0 < len(command_id) <= 64 else ""
