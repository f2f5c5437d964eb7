"""Figures of a live benchmark, from stamps and the reference of the same run. Pure."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum

from pydantic import BaseModel

from deltaq_experiments.bench.hop_reference import HOPS, HopTimes
from deltaq_experiments.bench.journeys import (
    OF_INCREMENT,
    Journey,
    RobotStamps,
    goes_after,
    journeys,
    journeys_of,
)
from deltaq_protocol.stamps import CycleOutcome, StampStation

# Ages and durations as p50, p99, p99.9 and the longest.


class Quantiles(BaseModel, frozen=True):
    """A distribution in four figures, by nearest rank; all None where nothing was measured.

    Attributes:
        count: how many were measured.
        p50: the value that half of them do not exceed.
        p99: the value that 99 % of them do not exceed.
        p99_9: the value that 99.9 % of them do not exceed; with fewer than a thousand it is the longest.
        longest: the greatest of them.
    """

    count: int
    p50: float | None
    p99: float | None
    p99_9: float | None
    longest: float | None

    @classmethod
    def of(cls, values: Sequence[float]) -> Quantiles:
        """Of values in any order; the figures have their unit."""
        if not values:
            return cls(count=0, p50=None, p99=None, p99_9=None, longest=None)
        ordered = sorted(values)

        def rank(per_mille: int) -> float:
            # whole numbers: 0.999 * 1000 is not 999 in every rounding
            return ordered[max(0, math.ceil(per_mille * len(ordered) / 1000) - 1)]

        return cls(count=len(ordered), p50=rank(500), p99=rank(990), p99_9=rank(999), longest=ordered[-1])


def ratio(value: float | None, reference: float | None) -> float | None:
    """One figure as a multiple of another; None where either is missing, or the reference is nothing."""
    if value is None or reference is None or reference <= 0.0:
        return None
    return value / reference


# Why a cycle got no fresh admission: the first station that its increment did not pass in time. Pure.
#
# An increment belongs to the cycle whose setpoint it goes into. Where a cycle has none, it is missing or
# was late: the one that answers the state after that which the setpoint before it answers.


class BrakeCause(StrEnum):
    """Why a cycle had no fresh admission; the value is the text of the report."""

    HELD = "the robot was held or not ready"
    REPLY_MISSED = "the KRC had missed the reply before"
    STATE_MISSED = "the controller did not take the state before"
    NO_INCREMENT = "the controller sent no increment for it"
    CLIENT_LATE = "the controller sent its increment too late"
    ON_WAY_TO_HLI = "the increment was lost or late on its way to the HLI"
    ON_WAY_TO_GATE = "the HLI did not pass it on in time"
    NOT_DECIDED = "the gate refused it, or did not start in time"
    GATE_LATE = "the gate had not decided in time"
    GATE_HELD = "the gate held the robot: no part of it was admissible"
    PLACED_LATER = "the gate gave it a later setpoint"
    ADMISSION_LATE = "the admission was late"
    ADMISSION_LOST = "the admission was lost"
    ADMISSION_REFUSED = "the Robot Server refused the admission"
    CHAIN_BROKE = "it would have followed a setpoint that was missed"


def causes(stamps: RobotStamps, cycles: Iterable[int], lookahead_cycles: int = 1) -> Counter[BrakeCause]:
    """Count the cycles without a fresh admission, by cause.

    Args:
        stamps: of one robot.
        cycles: numbers of the cycles to judge; those with a fresh admission are left out.
        lookahead_cycles: of the cell's gate.
    """
    outcomes, blame = stamps.outcomes, _Blame(stamps, lookahead_cycles)
    missed = (cycle for cycle in cycles if outcomes.get(cycle) not in (None, CycleOutcome.FRESH))
    return Counter(blame.cause(cycle) for cycle in missed)


class _Blame:
    """Finds the cause of a braked cycle.

    Args:
        stamps: of the robot.
        lookahead_cycles: of the cell's gate.
    """

    def __init__(self, stamps: RobotStamps, lookahead_cycles: int) -> None:
        self._stamps, self._ahead = stamps, lookahead_cycles
        answered = {cycle for station in OF_INCREMENT for cycle, _ in stamps.of_number[station]}
        self._by_setpoint: dict[int, Journey] = {}
        self._by_cycle: dict[int, list[Journey]] = {}
        for journey in journeys_of(stamps, answered, lookahead_cycles):
            self._by_cycle.setdefault(journey.cycle, []).append(journey)
            if journey.setpoint_cycle is not None:
                self._by_setpoint[journey.setpoint_cycle] = journey
        self._setpoints = sorted(self._by_setpoint)
        decided = stamps.of_number[StampStation.DECIDED]
        self._decided_ns = {
            before + 1: decided.get(decision, 0)
            for decision, before in goes_after(stamps, lookahead_cycles).items()
        }

    def cause(self, cycle: int) -> BrakeCause:
        """The cause of one cycle without a fresh admission."""
        outcome = self._stamps.outcomes[cycle]
        if outcome is CycleOutcome.HELD:
            return BrakeCause.HELD
        if outcome is CycleOutcome.REPLY_MISSED:
            return BrakeCause.REPLY_MISSED
        if any(self._broke_at(cycle - later) for later in range(1, self._ahead)):
            return BrakeCause.CHAIN_BROKE
        if self._was_admitted(cycle):
            return self._of_admission(cycle)
        return self._of_increment(cycle)

    def _was_admitted(self, cycle: int) -> bool:
        return cycle - 1 in self._stamps.of_cycle[StampStation.ADMISSION_OUT]

    def _broke_at(self, cycle: int) -> bool:
        """Whether a setpoint was missed though there was an admission for it."""
        is_fresh = self._stamps.outcomes.get(cycle) in (None, CycleOutcome.FRESH)
        return not is_fresh and self._was_admitted(cycle)

    def _of_admission(self, cycle: int) -> BrakeCause:
        due_ns = self._stamps.of_cycle[StampStation.TELEGRAM][cycle]
        came_ns = self._stamps.of_cycle[StampStation.ADMISSION_AT_SERVER].get(cycle - 1)
        if came_ns is None:
            return BrakeCause.ADMISSION_LOST
        if self._decided_ns.get(cycle, 0) >= due_ns:
            return BrakeCause.GATE_LATE
        return BrakeCause.ADMISSION_LATE if came_ns >= due_ns else BrakeCause.ADMISSION_REFUSED

    def _of_increment(self, cycle: int) -> BrakeCause:
        answered = self._answered_by(cycle)
        due_ns = self._stamps.of_cycle[StampStation.TELEGRAM][cycle]
        increments = self._by_cycle.get(answered, [])
        if any(one.decided_on is not None and one.setpoint_cycle is None for one in increments):
            return BrakeCause.GATE_HELD
        if not any(StampStation.INCREMENT_OUT in one.at_ns for one in increments):
            was_seen = answered in self._stamps.of_cycle[StampStation.STATE_AT_CLIENT]
            return BrakeCause.NO_INCREMENT if was_seen else BrakeCause.STATE_MISSED
        for station, cause in (
            (StampStation.INCREMENT_OUT, BrakeCause.CLIENT_LATE),
            (StampStation.INCREMENT_AT_HLI, BrakeCause.ON_WAY_TO_HLI),
            (StampStation.REQUEST_AT_GATE, BrakeCause.ON_WAY_TO_GATE),
            (StampStation.DECISION_BEGUN, BrakeCause.NOT_DECIDED),
            (StampStation.DECIDED, BrakeCause.GATE_LATE),
        ):
            if min((one.at_ns.get(station, due_ns) for one in increments), default=due_ns) >= due_ns:
                return cause
        return BrakeCause.PLACED_LATER

    def _answered_by(self, cycle: int) -> int:
        """The state whose answer the cycle lacks: the one after that which the setpoint before it answers."""
        index = bisect_left(self._setpoints, cycle)
        before = self._setpoints[index - 1] if index else None
        if before is None or before < cycle - self._ahead:
            return cycle - self._ahead
        return min(self._by_setpoint[before].cycle + 1, cycle - 1)


SLOW_CYCLE_S = 0.012
"""Cycle of the slower of the two shipped cells, which has other bounds than the quicker one [s]."""
RATE_AT_LEAST, RATE_AT_LEAST_QUICK = 0.999, 0.995
"""Promised admission rate in cells of `SLOW_CYCLE_S` or slower, and in quicker ones."""
CLIENT_CYCLE_AT_MOST_MS = 24.0
"""Promised bound of a controller's cycle in cells of `SLOW_CYCLE_S` or slower; quicker cells have none [ms]."""

NAMES = {
    StampStation.STATE_OUT: "state out",
    StampStation.STATE_AT_CLIENT: "state at the controller",
    StampStation.INCREMENT_OUT: "increment out",
    StampStation.INCREMENT_AT_HLI: "increment at the HLI",
    StampStation.REQUEST_AT_GATE: "request at the gate",
    StampStation.DECISION_BEGUN: "decision begun",
    StampStation.DECIDED: "decided",
    StampStation.ADMISSION_OUT: "admission out",
    StampStation.ADMISSION_AT_SERVER: "admission at the Robot Server",
}
"""Names of the stations in reports, in their order; ages count from the KRC's telegram."""


class StationAges(BaseModel, frozen=True):
    """Ages of a robot's increments at one station.

    Attributes:
        station: its name in reports.
        age_ms: time from the telegram that the increment answers to this station [ms].
        missing: number of sent increments without a stamp here.
        hops: number of hops of the reference that correspond to this station; None if none do.
        reference_ms: ages of the reference's messages after that number of hops [ms]; None without hops.
        ratio_p50: median age divided by the reference's median age.
        ratio_p99: the same of the 99 % quantiles.
    """

    station: str
    age_ms: Quantiles
    missing: int
    hops: int | None
    reference_ms: Quantiles | None
    ratio_p50: float | None
    ratio_p99: float | None


class RobotFigures(BaseModel, frozen=True):
    """Figures of one robot in the measured window.

    Attributes:
        cycles: number of cycles in the window.
        fresh: number of these with a fresh admission.
        admission_rate: fresh / cycles; None without cycles.
        braked: number of the other cycles, by cause (values of `BrakeCause`).
        increments: number of increments that answer cycles of the window.
        stations: ages of these increments, one entry for each of `NAMES`.
        longest_client_cycle_ms: longest time between two states that the controller received [ms].
    """

    cycles: int
    fresh: int
    admission_rate: float | None
    braked: dict[str, int]
    increments: int
    stations: tuple[StationAges, ...]
    longest_client_cycle_ms: float | None


class LiveRow(BaseModel, frozen=True):
    """One figure beside the reference of the same run, and its bound.

    Attributes:
        what: name of the figure in the report.
        value: measured in the cell; None if it could not be measured.
        unit: of value, reference and bounds.
        reference: the same figure of the reference; None without one.
        ratio: value / reference; None without either.
        at_most, at_least: bounds of the value; None for none.
        kept: whether the bounds are kept; None without a bound. A figure that could not be measured does not keep
            its bound.
    """

    what: str
    value: float | None
    unit: str
    reference: float | None
    ratio: float | None
    at_most: float | None
    at_least: float | None
    kept: bool | None

    @classmethod
    def of(
        cls,
        what: str,
        value: float | None,
        unit: str,
        reference: float | None,
        *,
        at_most: float | None = None,
        at_least: float | None = None,
    ) -> LiveRow:
        """Make a row; `ratio` and `kept` are computed."""
        kept = None
        if at_most is not None or at_least is not None:
            below = at_most is None or (value is not None and value <= at_most)
            above = at_least is None or (value is not None and value >= at_least)
            kept = below and above
        return cls(
            what=what,
            value=value,
            unit=unit,
            reference=reference,
            ratio=ratio(value, reference),
            at_most=at_most,
            at_least=at_least,
            kept=kept,
        )


def robot_figures(
    stamps: RobotStamps, begin_ns: int, end_ns: int, reference: HopTimes, lookahead_cycles: int = 1
) -> RobotFigures:
    """The figures of one robot in a window of time.

    Args:
        stamps: of the robot.
        begin_ns: begin of the window, on the clock of the stamps [ns].
        end_ns: its end [ns].
        reference: hop times of the reference in the same run.
        lookahead_cycles: of the cell's gate.
    """
    outcomes = stamps.outcomes
    cycles = [cycle for cycle in stamps.cycles_in(begin_ns, end_ns) if cycle in outcomes]
    fresh = sum(outcomes[cycle] is CycleOutcome.FRESH for cycle in cycles)
    braked = causes(stamps, cycles, lookahead_cycles)
    travelled = journeys(stamps, begin_ns, end_ns, lookahead_cycles)
    return RobotFigures(
        cycles=len(cycles),
        fresh=fresh,
        admission_rate=fresh / len(cycles) if cycles else None,
        braked={cause.value: count for cause, count in braked.most_common()},
        increments=len(travelled),
        stations=tuple(_station(station, travelled, reference) for station in NAMES),
        longest_client_cycle_ms=_longest_client_cycle_ms(stamps, begin_ns, end_ns),
    )


def bounded_rows(
    robots: Mapping[str, RobotFigures],
    processor_us: Mapping[str, float],
    reference: HopTimes,
    reference_processor_us: float,
    stolen_share: float | None,
) -> tuple[LiveRow, ...]:
    """The rows of the report: admission rate and longest controller cycle of each robot, processor time, stolen time.

    Args:
        robots: figures of each robot, by name.
        processor_us: processor time of each process in a cycle, by process [µs].
        reference: hop times of the reference in the same run.
        reference_processor_us: processor time of the reference in a cycle, all its processes [µs].
        stolen_share: share of the processor time that the host of a virtual machine gave to others; None if unknown.
    """
    slow = reference.cycle_s >= SLOW_CYCLE_S
    longest_s = reference.longest_client_cycle_s
    longest_ms = None if longest_s is None else longest_s * 1e3
    at_least = 100.0 * (RATE_AT_LEAST if slow else RATE_AT_LEAST_QUICK)
    at_most = CLIENT_CYCLE_AT_MOST_MS if slow else None
    rows = []
    for name, robot in robots.items():
        rate = None if robot.admission_rate is None else 100.0 * robot.admission_rate
        longest = robot.longest_client_cycle_ms
        rows += [
            LiveRow.of(f"{name}: admission rate", rate, "%", 100.0 * reference.in_time, at_least=at_least),
            LiveRow.of(
                f"{name}: longest cycle of its controller", longest, "ms", longest_ms, at_most=at_most
            ),
        ]
    spent_us = sum(processor_us.values())
    rows.append(
        LiveRow.of("processor time of a cycle, all processes", spent_us, "µs", reference_processor_us)
    )
    stolen = None if stolen_share is None else 100.0 * stolen_share
    rows.append(LiveRow.of("processor time that the host gave to others", stolen, "%", None))
    return tuple(rows)


def _station(station: StampStation, travelled: Sequence[Journey], reference: HopTimes) -> StationAges:
    ages = [age_ns / 1e6 for one in travelled if (age_ns := one.age_ns(station)) is not None]
    age_ms, hops = Quantiles.of(ages), HOPS.get(station)
    reference_ms = None
    if hops is not None:
        reference_ms = Quantiles.of([age_s * 1e3 for age_s in reference.ages_s(hops)])
    return StationAges(
        station=NAMES[station],
        age_ms=age_ms,
        missing=len(travelled) - len(ages),
        hops=hops,
        reference_ms=reference_ms,
        ratio_p50=None if reference_ms is None else ratio(age_ms.p50, reference_ms.p50),
        ratio_p99=None if reference_ms is None else ratio(age_ms.p99, reference_ms.p99),
    )


def _longest_client_cycle_ms(stamps: RobotStamps, begin_ns: int, end_ns: int) -> float | None:
    taken = sorted(
        at for at in stamps.of_cycle[StampStation.STATE_AT_CLIENT].values() if begin_ns <= at < end_ns
    )
    gaps = [after - before for before, after in itertools.pairwise(taken)]
    return max(gaps) / 1e6 if gaps else None
