"""Messages of `deltaq drive` on standard error while a robot is driven."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from deltaq_controllers.advisor.advisor import NOT_LOOKED_FOR
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.motion import Grip, ModeName

if TYPE_CHECKING:
    from deltaq_controllers.advisor.advisor import Option
    from deltaq_controllers.modes.teleoperator import Teleoperator
    from deltaq_controllers.operator_input.interface import OperatorInput
    from deltaq_controllers.signals import SignalLog

EVERY_CYCLES = 10
WIDTH = 150
_BAR = 10


class Display:
    """Shows the mode, what limits it, and the advisor's options as they become known.

    On a terminal the state stays in one line, behind a bar of how much goes through; otherwise there is a line for each
    change.

    Args:
        teleoperator: of the robot.
        operator: where the commands come from.
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
        if self._teleoperator.mode is not ModeName.ADVISOR:
            return
        mode = self._teleoperator.mode_named(ModeName.ADVISOR)
        assert isinstance(mode, AdvisorMode)
        lines = {rank: option_line(rank, option) for rank, option in enumerate(mode.options, start=1)}
        start = "\r\x1b[2K" if self._is_terminal else ""
        for rank, line in lines.items():
            if self._options.get(rank) != line:
                print(f"{start}deltaq: {line}", file=sys.stderr, flush=True)
        self._options = lines


def bar(share: float) -> str:
    """The share of what is asked for that goes through, as a bar: short is near to being stopped."""
    full = round(_BAR * share)
    return f"[{'#' * full}{'.' * (_BAR - full)}]"


def option_line(rank: int, option: Option) -> str:
    """An option in a line, for people."""
    clearance = f"{1000 * option.clearance.distance_m:.0f} mm between {' and '.join(option.clearance.pair)}"
    limit = f"{option.nearest_limit} {100 * option.limit_share:.0f} % from its limit"
    if option.path is not None:
        way = "a path is known" + (", the hands leave and come back" if option.hands_leave else "")
    else:
        way = "path " + NOT_LOOKED_FOR if option.no_path == NOT_LOOKED_FOR else f"no path: {option.no_path}"
    return f"option {rank}: energy {option.energy:.4f}, {clearance}, {limit}, {way}"
