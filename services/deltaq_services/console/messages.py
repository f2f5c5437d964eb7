"""The text messages between the console and a browser, as JSON: commands in; state, acknowledgements and events out.

Times named `_ms` are milliseconds of the clock of whoever wrote them; all else is in SI units. A command is answered
with one `ack` that carries its `id`; the same `id` twice is done once and answered twice. What it means that a command
expires is in `deltaq_services.console.clock_offset`.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from deltaq_protocol.driving import Axes, DrivingMode
from deltaq_protocol.messages import Count, Joints, JointValue, Message, Name, Outcome, Phase
from deltaq_protocol.reasons import ReasonCode

MAX_MESSAGE_BYTES = 4096
"""Longest message that a browser may send."""
MOST_MESSAGES_S = 120.0
"""Messages that a browser may send in a second; `stop` is not counted among them."""

_MOTION_S, _OTHER_S = 0.5, 2.0
EXPIRY_S = {
    "lease": _OTHER_S,
    "reset": _OTHER_S,
    "mode": _MOTION_S,
    "jog": _MOTION_S,
    "view_distance": _MOTION_S,
    "output": _MOTION_S,
    "dry_run": _OTHER_S,
    "record": _OTHER_S,
    "replay": _OTHER_S,
}
"""How late a command may come, by its type [s]: later it is not carried out. A stop is, whenever it comes."""

CommandId = Annotated[str, Field(min_length=1, max_length=64)]
SignalState = Annotated[str, Field(min_length=1, max_length=64)]


class ConsoleCommand(Message):
    """Base of what a browser sends."""

    id: CommandId
    sent_ms: FiniteFloat


class Ping(ConsoleCommand):
    """Measures the clocks; answered with a `Pong`, not with an `Ack`. To be sent once a second or more often."""

    type: Literal["ping"]


class Stop(ConsoleCommand):
    """Bring every robot to rest. It never expires, observers may send it, and it needs no field but its type."""

    type: Literal["stop"]
    id: Annotated[str, Field(max_length=64)] = ""
    sent_ms: FiniteFloat = 0.0


class Reset(ConsoleCommand):
    """End the hold of a robot."""

    type: Literal["reset"]
    robot: Name


class LeaseVerb(StrEnum):
    """What can be done about a robot's lease: `ask` its holder for it, who answers with `grant` or `refuse`."""

    TAKE = "take"
    RELEASE = "release"
    ASK = "ask"
    GRANT = "grant"
    REFUSE = "refuse"


class LeaseCommand(ConsoleCommand):
    """Take a robot's lease, give it back, or hand it over."""

    type: Literal["lease"]
    robot: Name
    action: LeaseVerb


class SetMode(ConsoleCommand):
    """How the robot is driven from now on, and in which axes hands are moved."""

    type: Literal["mode"]
    robot: Name
    mode: DrivingMode
    frame: Axes = "world"


class Jog(ConsoleCommand):
    """A wish to move, which ends by itself after 0.25 s unless it is renewed by the next one.

    Without `hand` the wish is a speed for each joint, (n,) [rad/s or m/s]; with it a twist of that hand, (6,): three
    linear [m/s] and three angular [rad/s] in the axes of the mode's frame. `option` is the advisor's, held down.
    """

    type: Literal["jog"]
    robot: Name
    wish: Annotated[tuple[JointValue, ...], Field(max_length=32)] = ()
    hand: Annotated[str, Field(max_length=64)] = ""
    option: Annotated[int, Field(ge=1, le=99)] | None = None


class ViewDistance(ConsoleCommand):
    """The distance that a follower keeps from its focus [m]."""

    type: Literal["view_distance"]
    robot: Name
    value_m: Annotated[float, Field(ge=0.2, le=4.0, allow_inf_nan=False)]


class SetOutput(ConsoleCommand):
    """Switch a digital output, by its place in the robot's `outputs`."""

    type: Literal["output"]
    robot: Name
    index: Annotated[int, Field(ge=0, le=63)]
    value: bool


class DryRun(ConsoleCommand):
    """The gate's verdict on an increment if it came now, (n,) [rad or m]; nothing moves."""

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


RobotCommand = Reset | LeaseCommand | SetMode | Jog | ViewDistance | SetOutput | DryRun
AnyCommand = Ping | Stop | Record | ReplayShown | RobotCommand
COMMANDS: TypeAdapter[AnyCommand] = TypeAdapter(Annotated[AnyCommand, Field(discriminator="type")])


class ConsoleHello(Message):
    """First message to a browser: who it is here, and what it may do.

    `operator` is False for one that may only look and stop; `token_needed` says that a token would change this.
    """

    type: Literal["hello"] = "hello"
    client: str
    operator: bool
    token_needed: bool
    server_ms: FiniteFloat


class Pong(Message):
    """Answer to a `Ping`: its `sent_ms`, and this server's clock."""

    type: Literal["pong"] = "pong"
    id: str
    sent_ms: FiniteFloat
    server_ms: FiniteFloat


class AckOutcome(StrEnum):
    """What became of a command; `asked` means that the answer is still to be seen, in `status`."""

    DONE = "done"
    ASKED = "asked"
    REFUSED = "refused"
    EXPIRED = "expired"


class Ack(Message):
    """Answer to a command. `id` is empty if the message could not be read that far; `verdict` answers a dry run."""

    type: Literal["ack"] = "ack"
    id: str
    outcome: AckOutcome
    text: str = ""
    verdict: Outcome | None = None
    scale: FiniteFloat | None = None
    pair: tuple[str, str] | None = None


class StopPhase(StrEnum):
    """How far a stop has come: sent to the HLI, latched by the gate, and every robot seen at rest."""

    NONE = "none"
    ASKED = "asked"
    STOPPING = "stopping"
    AT_REST = "at_rest"


class LeaseView(Message):
    """Who holds a robot's lease; `mine` is True for the client that is told, `wanted_by` asks for it."""

    holder: str | None = None
    mine: bool = False
    wanted_by: str | None = None
    text: str = ""


class Bound(Message):
    """What bound the last verdict that was not admitted whole: in words, and the bodies or joint concerned."""

    outcome: Outcome
    code: ReasonCode
    text: str
    bodies: tuple[str, ...] = ()
    joint: str | None = None


class RobotStatusView(Message):
    """One robot as a browser is told about it. `driving` is what its driver says of itself, in words."""

    phase: Phase
    reason: ReasonCode | None = None
    text: str = ""
    remedy: str = ""
    lease: LeaseView = LeaseView()
    mode: DrivingMode | None = None
    frame: Axes = "world"
    driving: str = ""
    view_distance_m: FiniteFloat | None = None
    bound: Bound | None = None
    outputs: dict[SignalState, bool] = {}
    inputs: dict[SignalState, bool] = {}


class RecordingView(Message):
    """What becomes of recordings: `file` is being written since `since_s`, which is None until it is.

    `text` says what became of the last one.
    """

    file: str = ""
    since_s: FiniteFloat | None = None
    text: str = ""


class ConsoleStatus(Message):
    """What changes seldom; sent when it has changed, and once a second.

    `hli` is False while the HLI is not heard: then `text` says why, and all else is old. `recording` is None for a
    console that was given no folder for recordings.
    """

    type: Literal["status"] = "status"
    hli: bool
    text: str = ""
    robots: dict[str, RobotStatusView]
    stop: StopPhase = StopPhase.NONE
    wanted_by: str | None = None
    clients: Count = 0
    recording: RecordingView | None = None


class ConsoleEvent(Message):
    """A line of the log; `count` is how often it has come since it was told last."""

    type: Literal["event"] = "event"
    time_s: FiniteFloat
    kind: Literal["verdict", "lease", "stop", "phase", "link", "client", "recording"]
    robot: str = ""
    text: str
    count: Count = 1
