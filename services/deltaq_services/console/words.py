"""What a console says in words: phases with their remedy, and what bound a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping

from deltaq_protocol.messages import Outcome, Phase, Reason, RobotState, Sight, Verdict
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_services.console.messages import Bound

_PHASES = {
    Phase.OFFLINE: "offline: its controller or the gate is not heard",
    Phase.READY: "ready",
    Phase.ENGAGED: "engaged",
    Phase.BRAKING: "braking: no increment was admitted for this cycle",
    Phase.HELD: "held",
}
_SIGHTS = {
    Sight.STALE: "its view of the leader is stale (view_stale)",
    Sight.LOST: "its view of the leader is lost (view_lost)",
    Sight.HIDDEN: "a body hides what its camera looks at (view_hidden)",
    Sight.FRESH: "its camera sees its target",
}
_REMEDIES = {
    ReasonCode.OPERATOR_STOP: "Reset it when the cell is clear.",
    ReasonCode.CONTROLLER_LOST: "Reset it, then drive on.",
    ReasonCode.HLI_LOST: "Make sure that the HLI runs, then reset it.",
    ReasonCode.GATE_LOST: "Make sure that the gate runs, then reset it.",
    ReasonCode.KRC_LOST: "Start the robot program on the KRC again, then reset it.",
    ReasonCode.TRACKING_ERROR: "Find what obstructs the robot, then reset it.",
    ReasonCode.REPLY_REFUSED: "Keep the Robot Server's log, then reset it.",
    ReasonCode.CYCLE_MISMATCH: "Let the KRC's program start RSI with the cell's cycle, or correct cycle_s.",
    ReasonCode.CRASH_BRAKE_LOST: "Another such process is started: reset the robot, and keep the Robot Server's log.",
    ReasonCode.RSI_MODE: "Change the KRC's program to begin RSI with RSI_ON(#ABSOLUTE), then reset it.",
    ReasonCode.DRIVE_LAG: "Set gate.servo_lag_s as the Robot Server's detail says, then start the cell again.",
}
_NEAR = (ReasonCode.CLEARANCE, ReasonCode.RETREAT, ReasonCode.SLOW_DOWN)
_OF_JOINT = {
    ReasonCode.POSITION_LIMIT: "at its position limit",
    ReasonCode.VELOCITY_LIMIT: "at its velocity limit",
    ReasonCode.ACCELERATION_LIMIT: "at its acceleration limit",
}


def phase_words(state: RobotState | None, is_stale: bool) -> tuple[str, str]:
    """What the state of a robot means, and what to do about it; empty if nothing is to be done."""
    if state is None:
        return "not heard yet", "Check that its Robot Server and the HLI run: deltaq status."
    if is_stale:
        return (
            "no state comes: what is shown is old",
            "Check that its Robot Server and the HLI run: deltaq status.",
        )
    text = _PHASES[state.phase]
    if state.sight is not None and state.sight is not Sight.FRESH:
        text += f", and {sight_words(state.sight)}"
    if state.reason is None:
        return text, ""
    if state.phase is Phase.HELD:
        return f"held: {EXPLANATIONS[state.reason]}", _REMEDIES.get(
            state.reason, "Remove the cause, then reset it."
        )
    return f"{text.partition(':')[0]}: {EXPLANATIONS[state.reason]}", _REMEDIES.get(state.reason, "")


def sight_words(sight: Sight) -> str:
    """How well a camera sees what it looks at."""
    return _SIGHTS[sight]


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
