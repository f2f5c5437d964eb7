"""Messages from the console to browsers, as JSON, and their wording; times as in `commands`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.driving import (
    DriverWays,
    DrivingMode,
    Fraction,
    Frame,
    Grip,
    HandsOff,
    RoutineProgress,
    Search,
)
from deltaq_protocol.messages import (
    Count,
    Message,
    Outcome,
    Phase,
    Real,
    Reason,
    RobotState,
    Sight,
    ToolName,
    Verdict,
)
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode

SignalState = Annotated[str, Field(min_length=1, max_length=64)]

_PHASES = {
    Phase.OFFLINE: "offline: nothing comes from its controller or from the gate",
    Phase.READY: "ready",
    Phase.ENGAGED: "engaged",
    Phase.BRAKING: "braking: no increment was admitted for this cycle",
    Phase.HELD: "held",
}
SIGHTS = {
    Sight.STALE: "its view of the leader is stale (view_stale)",
    Sight.LOST: "its view of the leader is lost (view_lost)",
    Sight.HIDDEN: "a body hides its camera's target (view_hidden)",
    Sight.OUT_OF_REACH: "limits or bodies keep its camera from the view asked for (view_out_of_reach)",
    Sight.FRESH: "its camera sees its target",
}
"""How well a camera sees its target, in words."""
_REMEDIES = {
    ReasonCode.OPERATOR_STOP: "Reset it when the cell is clear.",
    ReasonCode.CONTROLLER_LOST: "Reset it, then drive on.",
    ReasonCode.HLI_LOST: "Start the HLI if it does not run, then reset the robot.",
    ReasonCode.GATE_LOST: "Start the gate if it does not run, then reset the robot.",
    ReasonCode.KRC_LOST: "Start the robot program on the KRC again, then reset it.",
    ReasonCode.TRACKING_ERROR: "Find what obstructs the robot, then reset it.",
    ReasonCode.REPLY_REFUSED: "Keep the Robot Server's log, then reset it.",
    ReasonCode.CYCLE_MISMATCH: "Let the KRC's program start RSI with the cell's cycle, or correct cycle_s.",
    ReasonCode.CRASH_BRAKE_LOST: "It is restarted automatically. Reset the robot, and keep the Robot Server's log.",
    ReasonCode.RSI_MODE: "Change the KRC's program to begin RSI with RSI_ON(#ABSOLUTE), then reset it.",
    ReasonCode.DRIVE_LAG: "Set gate.servo_lag_s as the Robot Server's detail says, then start the cell again.",
}
_NEAR = (ReasonCode.CLEARANCE, ReasonCode.RETREAT, ReasonCode.SLOW_DOWN)
_OF_JOINT = {
    ReasonCode.POSITION_LIMIT: "at its position limit",
    ReasonCode.VELOCITY_LIMIT: "at its velocity limit",
    ReasonCode.ACCELERATION_LIMIT: "at its acceleration limit",
}


class ConsoleHello(Message):
    """First message to a browser: its name and its rights.

    `operator` is False for one that may only look and stop; `token_needed` says that a token would change this.
    `console` is this process's own: a page that was loaded from another one knows neither its cell nor its clients.
    """

    type: Literal["hello"] = "hello"
    console: str
    client: str
    operator: bool
    token_needed: bool


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
    """Progress of a stop: sent to the HLI, latched by the gate, every robot at rest."""

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

    `goes_through` is the executed fraction of the command, in tenths; 1 if nothing limits it. `grip` is the chosen
    grip; `hands_off` is present once the end effectors hold an object. `master` names the robot that leads an end
    effector, with its displacement times `master_scale`; empty if none was chosen. `search` is present in modes that
    offer paths, which come in `WaysView`. `looks_at` is the target of its camera in words, and `sight` how well the
    controller sees it, if it says so; `targets` are the robots that it was asked to look at. `routines` and `routine`
    are those of its driver. `coupled` is its exchangeable tool, as in its states.
    """

    phase: Phase
    reason: ReasonCode | None = None
    text: str = ""
    remedy: str = ""
    lease: LeaseView = LeaseView()
    mode: DrivingMode | None = None
    frame: Frame = Frame.WORLD
    grip: Grip = Grip.FREE
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
    routines: dict[str, tuple[str, ...]] = {}
    routine: RoutineProgress | None = None
    bound: Bound | None = None
    outputs: dict[SignalState, bool] = {}
    inputs: dict[SignalState, bool] = {}
    coupled: ToolName | None = None


class WaysView(DriverWays):
    """The paths that a robot's driver offers now; sent when they change."""

    robot: str


class RecordingView(Message):
    """The state of recordings: `file` is being written since `since_s`, None before its first message.

    `text` is the result of the last one.
    """

    file: str = ""
    since_s: Real | None = None
    text: str = ""


class ConsoleStatus(Message):
    """The status of the cell; sent when it has changed, and once a second.

    `hli` is False while the HLI is silent: then `text` says why, `remedy` what to do, and all else is old.
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


def phase_words(state: RobotState | None, is_stale: bool) -> tuple[str, str]:
    """The meaning of a robot's state and the remedy; empty if no action is needed."""
    if state is None:
        return "no state has come yet", "Check that its Robot Server and the HLI run: deltaq status."
    if is_stale:
        return (
            "no state comes: the picture is old",
            "Check that its Robot Server and the HLI run: deltaq status.",
        )
    text = _PHASES[state.phase]
    if state.sight is not None and state.sight is not Sight.FRESH:
        text += f", and {SIGHTS[state.sight]}"
    if state.reason is None:
        return text, ""
    if state.phase is Phase.HELD:
        return f"held: {EXPLANATIONS[state.reason]}", _REMEDIES.get(
            state.reason, "Remove the cause, then reset it."
        )
    return f"{text.partition(':')[0]}: {EXPLANATIONS[state.reason]}", _REMEDIES.get(state.reason, "")


def bound_of(verdict: Verdict, units: Mapping[str, str]) -> Bound | None:
    """What bound a verdict; None if it was admitted whole.

    Args:
        verdict: on an increment.
        units: `rad` or `m` of each joint of the robot, by name.
    """
    if verdict.outcome is Outcome.ADMITTED or not verdict.reasons:
        return None
    reason = verdict.reasons[0]
    bodies: tuple[str, ...] = ()
    joint = None
    if reason.code in _NEAR:
        bodies = tuple(reason.what.split())
        what = _near(bodies, reason)
    elif reason.code in _OF_JOINT:
        joint = reason.what
        what = f"{joint} {_OF_JOINT[reason.code]}{_limit(reason, units.get(joint))}"
    else:
        what = EXPLANATIONS[reason.code] + (f" ({reason.what})" if reason.what else "")
    share = f" to {verdict.scale:.0%}" if verdict.outcome is Outcome.SCALED else ""
    return Bound(
        outcome=verdict.outcome,
        code=reason.code,
        text=f"{verdict.outcome}{share}: {what}",
        bodies=bodies,
        joint=joint,
    )


def _near(bodies: tuple[str, ...], reason: Reason) -> str:
    if len(bodies) != 2:
        return EXPLANATIONS[reason.code]
    distance = "too near" if reason.value is None else f"{100 * reason.value:.1f} cm"
    kept = "" if reason.bound is None else f", {100 * reason.bound:.1f} cm are kept"
    apart = f"{bodies[0]} {distance} from {bodies[1]}{kept}"
    return f"{apart}, and approaching too fast" if reason.code is ReasonCode.SLOW_DOWN else apart


def _limit(reason: Reason, unit: str | None) -> str:
    if reason.bound is None or unit is None:
        return ""
    if reason.code is ReasonCode.POSITION_LIMIT:
        return f", {math.degrees(reason.bound):.1f}°" if unit == "rad" else f", {reason.bound:.3f} m"
    return ""
