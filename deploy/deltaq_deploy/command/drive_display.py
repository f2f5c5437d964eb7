"""Messages of `deltaq drive` on standard error while a robot is driven."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from deltaq_controllers.advisor.advisor import NOT_LOOKED_FOR
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_deploy.command.console import counts, print_table
from deltaq_protocol.driving import DrivingMode, Grip
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.reasons import ReasonCode

if TYPE_CHECKING:
    from deltaq_controllers.advisor.advisor import Option
    from deltaq_controllers.live import ControlStatistics
    from deltaq_controllers.modes.teleoperator import Teleoperator
    from deltaq_controllers.operator_input.interface import OperatorInput
    from deltaq_controllers.teleoperation import DriveLog, SignalLog


# The report of `deltaq drive` at its end.

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
        log: the stretches of the drive.
        statistics: counts of the verdicts.
        signals: the switched outputs.
        error: the error that ended the drive; None if it ended as commanded.
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
    """Print the drive as a table."""
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


EVERY_CYCLES = 10
WIDTH = 150
_BAR = 10


class Display:
    """Shows the mode, its limiting factor, and the advisor's options as they become known.

    On a terminal the state stays in one line, behind a bar of the executed fraction; otherwise there is a line for
    each change.

    Args:
        teleoperator: of the robot.
        operator: source of the commands.
        signals: outputs and inputs of the robot.
    """

    def __init__(self, teleoperator: Teleoperator, operator: OperatorInput, signals: SignalLog) -> None:
        self._teleoperator, self._operator, self._signals = teleoperator, operator, signals
        self._switched = 0
        self._is_terminal = sys.stderr.isatty()
        self._cycles = 0
        self._told = ""
        self._options: dict[int, str] = {}

    def show(self) -> None:
        """Update after a cycle."""
        self._cycles += 1
        if self._cycles % EVERY_CYCLES:
            return
        self._show_options()
        self._show_switched()
        teleoperator, limitation = self._teleoperator, self._teleoperator.limitation
        limit = f"limited, {limitation.limit.value}: {limitation.text}" if limitation else "free"
        through = bar(teleoperator.reflection.share)
        held = ", object held" if teleoperator.grip is Grip.OBJECT else ""
        mode = f"{teleoperator.mode.value} ({teleoperator.frame.value}{held})"
        if self._is_terminal:
            chosen, signals = self._operator.status, self._signals.status
            parts = (part for part in (through, mode, chosen, teleoperator.status, limit, signals) if part)
            sys.stderr.write(f"\r\x1b[2K{' | '.join(parts)[:WIDTH]}")
            sys.stderr.flush()
        elif f"{mode} {limitation and limitation.what}" != self._told:
            self._told = f"{mode} {limitation and limitation.what}"
            print(f"deltaq: {mode}: {limit}", file=sys.stderr, flush=True)

    def _show_switched(self) -> None:
        start = "\r\x1b[2K" if self._is_terminal else ""
        for switched in self._signals.switched[self._switched :]:
            told = switched.error or ("on" if switched.is_on else "off")
            print(f"{start}deltaq: {switched.output}: {told}", file=sys.stderr, flush=True)
        self._switched = len(self._signals.switched)

    def _show_options(self) -> None:
        if self._teleoperator.mode is not DrivingMode.ADVISOR:
            return
        mode = self._teleoperator.mode_named(DrivingMode.ADVISOR)
        assert isinstance(mode, AdvisorMode)
        lines = {rank: option_line(rank, option) for rank, option in enumerate(mode.options, start=1)}
        start = "\r\x1b[2K" if self._is_terminal else ""
        for rank, line in lines.items():
            if self._options.get(rank) != line:
                print(f"{start}deltaq: {line}", file=sys.stderr, flush=True)
        self._options = lines


def bar(share: float) -> str:
    """The executed fraction of the command, as a bar: short means nearly stopped."""
    full = round(_BAR * share)
    return f"[{'#' * full}{'.' * (_BAR - full)}]"


def option_line(rank: int, option: Option) -> str:
    """An option as one line of text."""
    clearance = f"{1000 * option.clearance.distance_m:.0f} mm between {' and '.join(option.clearance.pair)}"
    limit = f"{option.nearest_limit} {100 * option.limit_share:.0f} % from its limit"
    if option.path is not None:
        way = "a path is known" + (", the hands leave and come back" if option.hands_leave else "")
    else:
        way = "path " + NOT_LOOKED_FOR if option.no_path == NOT_LOOKED_FOR else f"no path: {option.no_path}"
    return f"option {rank}: energy {option.energy:.4f}, {clearance}, {limit}, {way}"
