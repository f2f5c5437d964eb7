"""Faults of a cell: of its processes, its links, its clocks, its controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from deltaq_emulator.faults import LinkFaults
from deltaq_testing.impairment.stream import StreamFaults
from deltaq_testing.virtual_cell.parts import Link, Process


class Misbehaviour(StrEnum):
    """What a controller does instead of answering every state once."""

    EVERY_FOURTH = "every fourth"
    NAN_FLOOD = "nan flood"
    LEAP = "leap"


@dataclass(frozen=True)
class Kill:
    """`kill -9`."""

    process: Process


@dataclass(frozen=True)
class Freeze:
    """SIGSTOP, and SIGCONT in the end."""

    process: Process


@dataclass(frozen=True)
class Slow:
    """All messages of a process are delayed by this."""

    process: Process
    delay_s: float


@dataclass(frozen=True)
class Impair:
    """Faults of the messages on a link."""

    link: Link
    faults: LinkFaults


@dataclass(frozen=True)
class ImpairStream:
    """Faults of the bytes of the TCP connection under a link."""

    link: Link
    faults: StreamFaults


@dataclass(frozen=True)
class ReadNothing:
    """Clients ask for everything and stop reading."""


@dataclass(frozen=True)
class FillDisk:
    """The recorder's disk is full."""


@dataclass(frozen=True)
class Misbehave:
    """The controller itself goes wrong."""

    how: Misbehaviour


@dataclass(frozen=True)
class StepClock:
    """The monotonic clock that a process reads jumps, as forward it does when a machine stood still."""

    process: Process
    by_s: float


@dataclass(frozen=True)
class SetWallClock:
    """The time of day is set in every service, or runs too fast from now on."""

    by_s: float = 0.0
    drift_ppm: int = 0


@dataclass(frozen=True)
class BeginInThePast:
    """`kill -9`, and the process that takes its place finds the time of day set back."""

    process: Process
    by_s: float


@dataclass(frozen=True)
class AskPanel:
    """A request to the panel of the emulated controller, as JSON."""

    request: Mapping[str, Any]


class Bombard(StrEnum):
    """Datagrams that somebody sends to the Robot Server beside its KRC, some in every cycle."""

    OVERSIZED = "oversized"
    """True telegrams with so much behind them that no telegram is so long."""
    PORT_ZERO = "port 0"
    """True telegrams from a port that nobody can be answered at."""


@dataclass(frozen=True)
class PressStop:
    """Somebody presses stop."""


Action = (
    Kill
    | Freeze
    | Slow
    | Impair
    | ImpairStream
    | ReadNothing
    | FillDisk
    | Misbehave
    | StepClock
    | SetWallClock
    | BeginInThePast
    | AskPanel
    | Bombard
    | PressStop
)
