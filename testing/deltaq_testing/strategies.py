"""Schedules of faults for hypothesis, which shrinks one that fails to the shortest that still does."""

from __future__ import annotations

from collections.abc import Iterable

from hypothesis import strategies as st

from deltaq_testing.faults.catalogue import Fault
from deltaq_testing.schedule import VIRTUAL, ScheduleError, TimedFault, clash, fault

GRID_S = 0.012
"""Times are multiples of this: a cycle of the slower KRC."""


def schedules(
    *,
    within_s: float,
    names: Iterable[str] | None = None,
    most: int = 3,
    longest_s: float = 1.0,
) -> st.SearchStrategy[tuple[TimedFault, ...]]:
    """Schedules of faults, of which no two change the same part of the cell at the same time.

    Schedules shrink towards fewer faults, faults that come first in `names` or in the catalogue, earlier begins, and
    shorter durations.

    Args:
        within_s: by when every fault has ended [s].
        names: faults to draw from; None for all that virtual time has.
        most: faults of a schedule.
        longest_s: greatest duration of a fault [s].

    Raises:
        UnknownFaultError: there is no fault of a name.
        ScheduleError: a bound leaves nothing to draw, or a fault is not possible in virtual time.
    """
    if most < 1:
        raise ScheduleError(f"most must be 1 or more, got {most}")
    longest = _cycles(min(longest_s, within_s))
    if longest < 1:
        raise ScheduleError(
            f"within_s and longest_s must be {GRID_S:g} s or more, got {within_s:g} and {longest_s:g}"
        )
    rows = VIRTUAL if names is None else tuple(fault(name, at_s=0.0).what for name in names)
    if not rows:
        raise ScheduleError("names must have at least one fault, got none")
    cycles = _cycles(within_s)

    def timed(what: Fault, length: int, begin: int) -> TimedFault:
        # every draw ends in time, so that none has to be discarded
        return TimedFault(what, min(begin, cycles - length) * GRID_S, length * GRID_S)

    one = st.builds(timed, st.sampled_from(rows), st.integers(1, longest), st.integers(0, cycles - 1))
    return st.lists(one, max_size=most).map(in_order).filter(lambda drawn: clash(drawn) is None)


def in_order(faults: Iterable[TimedFault]) -> tuple[TimedFault, ...]:
    """The faults sorted by their start times."""
    return tuple(sorted(faults, key=lambda timed: timed.at_s))


def _cycles(duration_s: float) -> int:
    """Whole cycles within a time, up to rounding."""
    return int(duration_s / GRID_S + 1e-6)
