"""Looks for a schedule of faults under which a scenario's expectations fail, and shrinks it to the shortest."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from hypothesis import HealthCheck, find, settings
from hypothesis.errors import NoSuchExample

from deltaq_testing.scenario.model import FaultEntry, Scenario
from deltaq_testing.scenario.run import Runner, ScenarioOutcome
from deltaq_testing.schedule import TimedFault
from deltaq_testing.strategies import schedules


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
