"""Schedules of faults for hypothesis, which shrinks one that fails to the shortest that still does."""

import random
from collections.abc import Callable, Iterable, Sequence

from hypothesis import HealthCheck, find, settings
from hypothesis import strategies as st
from hypothesis.errors import NoSuchExample

from deltaq_testing.faults.catalogue import Fault
from deltaq_testing.scenario.model import FaultEntry, Scenario
from deltaq_testing.scenario.run import Runner, ScenarioOutcome
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


# Looks for a schedule of faults under which a scenario's expectations fail, and shrinks it to the shortest.


def shortest_failure(
    scenario: Scenario,
    runner: Runner,
    name: str,
    examples: int,
    seed: int,
    on_run: Callable[[int], None] = lambda _: None,
) -> ScenarioOutcome | None:
    """The outcome of the shortest failing schedule found; None if no drawn schedule fails.

    Args:
        scenario: whose faults are drawn, as its `search` says.
        runner: runs it.
        name: of the outcome.
        examples: how many schedules are drawn before the search is given up.
        seed: of the draw: the same seed draws the same schedules.
        on_run: called after each run with the number of runs so far.

    Raises:
        DeltaqError: as `Runner.run`.
    """
    runs = 0

    def fails(faults: tuple[TimedFault, ...]) -> bool:
        nonlocal runs
        good = runner.run(with_faults(scenario, faults), name).good
        runs += 1
        on_run(runs)
        return not good

    asked = scenario.search
    until_s = scenario.duration_s if scenario.recover_at_s is None else scenario.recover_at_s
    drawn = schedules(within_s=until_s, names=asked.faults, most=asked.most, longest_s=asked.longest_s)
    limits = settings(
        max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    try:
        shortest = find(drawn, fails, settings=limits, random=random.Random(seed))
    except NoSuchExample:
        return None
    return runner.run(with_faults(scenario, shortest), name)


def with_faults(scenario: Scenario, faults: Sequence[TimedFault]) -> Scenario:
    """The scenario with these faults in place of its own.

    Expectations about rest, reasons and phase belong to the old faults and are dropped.
    """
    entries = [
        FaultEntry(fault=timed.what.name, at_s=round(timed.at_s, 6), for_s=round(timed.for_s, 6))
        for timed in faults
    ]
    # expectations about the file's own faults: other faults brake the robot elsewhere, and hold it for other reasons
    expect = scenario.expect.model_copy(update={"rested_within_cycles": None, "reasons": None, "phase": None})
    return scenario.model_copy(update={"faults": entries, "expect": expect})
