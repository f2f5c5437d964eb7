"""Schedules of faults for a tested controller."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.catalogue import (
    CATALOGUE,
    AskPanel,
    BeginInThePast,
    Bombard,
    Fault,
    Freeze,
    Impair,
    Kill,
    Misbehave,
    Slow,
    StepClock,
    fault_named,
)
from deltaq_testing.virtual_cell.parts import Link, Process

FOR_S = 0.5
"""Default duration of a fault [s]."""


class ScheduleError(DeltaqError):
    """A schedule has a fault that cannot be injected in this way or at this time."""


@dataclass(frozen=True)
class TimedFault:
    """A fault with its begin and its duration.

    Attributes:
        what: a row of the catalogue.
        at_s: when it begins [s] after the controller was connected.
        for_s: its duration [s]; without meaning for an instantaneous fault such as a stop.
    """

    what: Fault
    at_s: float
    for_s: float = FOR_S

    @property
    def end_s(self) -> float:
        """Time at which it ends [s]."""
        return self.at_s + self.for_s

    @property
    def parts(self) -> frozenset[str]:
        """The parts of the cell that it changes while it lasts."""
        match self.what.action:
            case Kill(process) | Freeze(process) | BeginInThePast(process, _):
                return frozenset({f"the {process}"})
            case Slow(Process.SIM, _):
                return frozenset({f"the link {Link.HLI_SIM}", f"the link {Link.SIM_SERVER}"})
            case Slow():
                return frozenset({f"the link {Link.CONTROLLER_HLI}"})
            case Impair(link, _):
                return frozenset({f"the link {link}"})
            case Misbehave():
                return frozenset({"the controller's requests"})
            case StepClock(process, _):
                return frozenset({f"the clock of the {process}"})
            case AskPanel():
                return frozenset({"the KRC or its wire"})
            case Bombard():
                return frozenset({"what is sent to the Robot Server"})
        return frozenset()

    def __str__(self) -> str:
        """As Python has it: `fault("controller-hli-cut", at_s=2, for_s=0.5)`."""
        return f'fault("{self.what.name}", at_s={self.at_s:g}, for_s={self.for_s:g})'

    __repr__ = __str__

    def as_dict(self) -> dict[str, Any]:
        """The fault in the form of scenario files."""
        return {"fault": self.what.name, "at_s": self.at_s, "for_s": self.for_s}


VIRTUAL = tuple(row for row in CATALOGUE if row.virtual)
"""The faults that are possible in virtual time."""


def fault(name: str, *, at_s: float, for_s: float = FOR_S) -> TimedFault:
    """A fault of the catalogue at a time.

    Args:
        name: as `deltaq fault list` shows it; underscores may stand for hyphens, and `link` for `controller-hli`, the
            link of the controller that is tested.
        at_s: when it begins [s] after the controller was connected; 0 or later.
        for_s: its duration [s]; more than 0.

    Raises:
        UnknownFaultError: there is no such fault; the message names the existing ones.
        ScheduleError: it does not exist in virtual time, or a time is out of its bounds.
    """
    row = fault_named(name)
    if not row.virtual:
        raise ScheduleError(f"{row.name} does not exist in virtual time; `deltaq fault list` shows which do")
    if not (0 <= at_s < math.inf):
        raise ScheduleError(f"{row.name}: at_s must be 0 or later, got {at_s!r}")
    if not (0 < for_s < math.inf):
        raise ScheduleError(f"{row.name}: for_s must be more than 0, got {for_s!r}")
    return TimedFault(row, float(at_s), float(for_s))


def clash(faults: Iterable[TimedFault]) -> tuple[TimedFault, TimedFault] | None:
    """The first two that change the same part of the cell at the same time; None if none do."""
    for one, other in combinations(sorted(faults, key=lambda timed: timed.at_s), 2):
        if other.at_s < one.end_s and one.parts & other.parts:
            return one, other
    return None


class FaultsOfARun:
    """The faults of a run: those that wait for their time, and those that stand."""

    def __init__(self) -> None:
        self._waiting: tuple[TimedFault, ...] = ()
        self._standing: list[TimedFault] = []

    def add(self, faults: Sequence[TimedFault], now_s: float) -> None:
        """Schedule faults; raises as `checked` does."""
        checked(faults, now_s)
        checked((*self._standing, *self._waiting, *faults))
        self._waiting = checked((*self._waiting, *faults))

    def due(self, now_s: float) -> Iterator[tuple[TimedFault, bool]]:
        """The faults whose end has come, and then those whose begin has; each with whether it begins."""
        for timed in [one for one in self._standing if one.end_s <= now_s]:
            self._standing.remove(timed)
            yield timed, False
        while self._waiting and self._waiting[0].at_s <= now_s:
            timed, *rest = self._waiting
            self._waiting = tuple(rest)
            yield timed, True
            self._standing.append(timed)

    def drop(self) -> list[TimedFault]:
        """Forget all faults; returns those that stand, the newest first."""
        self._waiting, standing = (), self._standing[::-1]
        self._standing = []
        return standing


def checked(faults: Sequence[TimedFault], now_s: float = 0.0) -> tuple[TimedFault, ...]:
    """The faults in the order of their times.

    Args:
        faults: to inject.
        now_s: present time [s].

    Raises:
        ScheduleError: one begins in the past, or two change the same part at the same time.
    """
    for timed in faults:
        if timed.at_s < now_s:
            raise ScheduleError(f"{timed}: at_s must be {now_s:g} or later, the present time")
    both = clash(faults)
    if both is not None:
        one, other = both
        part = min(one.parts & other.parts)
        raise ScheduleError(f"{other} must start at {one.end_s:g} s or later: {part} still suffers {one}")
    return tuple(sorted(faults, key=lambda timed: timed.at_s))
