"""What browsers are told by the console, as JSON: state, acknowledgements, ways, and events; times as in `commands`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.driving import Axes, DrivingMode, Fraction, HandGrip, HandsOff, Search, Way
from deltaq_protocol.messages import Count, Message, Outcome, Phase, Real, Sight
from deltaq_protocol.reasons import ReasonCode

SignalState = Annotated[str, Field(min_length=1, max_length=64)]


class ConsoleHello(Message):
    """First message to a browser: its name here, and what it may do.

    `operator` is False for one that may only look and stop; `token_needed` says that a token would change this.
    `console` is this process's own: a page that was loaded from another one knows neither its cell nor its clients.
    """

    type: Literal["hello"] = "hello"
    console: str
    client: str
    operator: bool
    token_needed: bool
    server_ms: Real


class Pong(Message):
    """Answer to a `Ping`: its `sent_ms`, and this server's clock."""

    type: Literal["pong"] = "pong"
    id: str
    sent_ms: Real
    server_ms: Real


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
    scale: Real | None = None
    pair: tuple[str, str] | None = None


class StopPhase(StrEnum):
    """How far a stop has come: sent to the HLI, latched by the gate, and every robot seen at rest."""

    NONE = "none"
    ASKED = "asked"
    STOPPING = "stopping"
    AT_REST = "at_rest"


class LeaseView(Message):
    """The holder of a robot's lease; `mine` is True for the client that gets this, `wanted_by` asks for the lease.

    `outside`: its holder is not a browser at this console, and so cannot be asked for it.
    """

    holder: str | None = None
    outside: bool = False
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
    """One robot's status for a browser. `driving` is the status of its driver in words.

    `goes_through` is the fraction of the wish that mode and gate let through, in tenths; 1 where nothing limits.
    `grip` is the one that was chosen; with an object, `hands_off` is there once the hands hold it. `master` leads a
    hand when a wish says so, `master_scale` times its way; it is empty where none was chosen. `search` is there in
    modes that offer ways; the ways themselves come in `WaysView`. `looks_at` is the target of its camera in words, and
    `sight` how well that is seen, while a controller says so; `targets` are the robots that it was asked to look at.
    """

    phase: Phase
    reason: ReasonCode | None = None
    text: str = ""
    remedy: str = ""
    lease: LeaseView = LeaseView()
    mode: DrivingMode | None = None
    frame: Axes = "world"
    grip: HandGrip = "free"
    hands_off: HandsOff | None = None
    master: str = ""
    master_scale: Real = 1.0
    driving: str = ""
    goes_through: Fraction = 1.0
    view_distance_m: Real | None = None
    sight: Sight | None = None
    looks_at: str = ""
    targets: tuple[str, ...] = ()
    search: Search | None = None
    bound: Bound | None = None
    outputs: dict[SignalState, bool] = {}
    inputs: dict[SignalState, bool] = {}


class WaysView(Message):
    """The ways that a robot's driver offers now, sent when they have changed."""

    type: Literal["ways"] = "ways"
    robot: str
    mode: DrivingMode
    ways: tuple[Way, ...] = ()


class RecordingView(Message):
    """What becomes of recordings: `file` is being written since `since_s`, which is None until it is.

    `text` says what became of the last one.
    """

    file: str = ""
    since_s: Real | None = None
    text: str = ""


class ConsoleStatus(Message):
    """What changes seldom; sent when it has changed, and once a second.

    `hli` is False while the HLI is not heard: then `text` says why, `remedy` what to do, and all else is old.
    `recording` is None for a console that was given no folder for recordings.
    """

    type: Literal["status"] = "status"
    hli: bool
    text: str = ""
    remedy: str = ""
    robots: dict[str, RobotStatusView]
    stop: StopPhase = StopPhase.NONE
    wanted_by: str | None = None
    clients: Count = 0
    recording: RecordingView | None = None


class ConsoleEvent(Message):
    """A line of the log; `count` is how often it has come since it was sent last."""

    type: Literal["event"] = "event"
    time_s: Real
    kind: Literal["verdict", "lease", "stop", "phase", "link", "client", "recording", "view"]
    robot: str = ""
    text: str
    count: Count = 1
