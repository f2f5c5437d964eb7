"""The report of `deltaq drive` at its end."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.reasons import ReasonCode

if TYPE_CHECKING:
    from deltaq_controllers.signals import SignalLog
    from deltaq_controllers.statistics import ControlStatistics
    from deltaq_controllers.teleoperation import DriveLog

REMEDIES = {
    ReasonCode.LEASE_NOT_HELD: "a lease is lost if somebody takes it, or if this machine is too busy to renew it in "
    "time: see `deltaq status` for its holder, end other programs, and drive again",
    ReasonCode.UNREACHABLE: "see `deltaq status` for the service that does not answer, and drive again",
}
"""Remedies for an unwanted end, where the error itself does not say enough."""


def summary(
    robot: str, log: DriveLog, statistics: ControlStatistics, signals: SignalLog, error: DeltaqError | None
) -> dict[str, Any]:
    """The drive as one JSON object.

    Args:
        robot: name of the robot.
        log: what was driven.
        statistics: counts of the verdicts.
        signals: what was switched.
        error: what ended the drive; None if it was ended as commanded.
    """
    return {
        "robot": robot,
        "error": None if error is None else _told(error),
        "legs": log.summary(),
        "missed": log.missed,
        "outputs": [switched.summary() for switched in signals.switched],
        **statistics.summary(),
    }


def _told(error: DeltaqError) -> dict[str, Any]:
    code = ReasonCode.UNREACHABLE.value if isinstance(error, ServiceUnreachableError) else None
    hint = ""
    if isinstance(error, RefusedError):
        code, hint = str(error.code), error.hint
    return {
        "code": code,
        "message": str(error),
        "hint": REMEDIES.get(ReasonCode(code), hint) if code else hint,
    }


def show(summary: dict[str, Any]) -> None:
    """The drive as a table, for people."""
    from deltaq_command.console import counts, print_table

    rows = [
        (
            leg["mode"] if leg["object"] is None else f"{leg['mode']}, object",
            f"{leg['seconds']:.1f}",
            hand,
            f"{figures['moved_mm']:.2f}",
            f"{figures['turned_deg']:.3f}",
            f"{figures['farthest_mm']:.2f}",
            ", ".join(f"{what} {seconds:.1f} s" for what, seconds in leg["limited_s"].items()) or None,
            ", ".join(f"{one['option']}{'' if one['reached'] else ' missed'}" for one in leg["options"])
            or None,
        )
        for leg in summary["legs"]
        for hand, figures in leg["hands"].items()
    ]
    if sys.stderr.isatty():
        sys.stderr.write("\n")
    columns = ("mode", "s", "hand", "moved mm", "turned deg", "farthest mm", "limited by", "options")
    print_table(f"{summary['robot']} was driven", columns, rows)
    print(f"gate: {counts(summary['gate'])}")
    for switched in summary["outputs"]:
        told = "on" if switched["on"] else "off"
        print(f"{switched['output']}: {switched['error'] or told}")
    if summary["error"] is not None:
        print(f"ended by {summary['error']['code'] or 'an error'}: {summary['error']['hint']}")
