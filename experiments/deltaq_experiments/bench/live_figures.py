"""Figures of a live benchmark, from stamps and the reference of the same run. Pure."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from pydantic import BaseModel, ConfigDict

from deltaq_experiments.bench.braked import causes
from deltaq_experiments.bench.hop_reference import HOPS, HopTimes
from deltaq_experiments.bench.journeys import Journey, RobotStamps, journeys
from deltaq_experiments.bench.quantiles import Quantiles, ratio
from deltaq_protocol.stamps import CycleOutcome, StampStation

SLOW_CYCLE_S = 0.012
"""Cycle of the slower of the two shipped cells; what is promised differs from the quicker one's [s]."""
RATE_AT_LEAST, RATE_AT_LEAST_QUICK = 0.999, 0.995
"""Admission rate that is promised from `SLOW_CYCLE_S` on, and below it."""
CLIENT_CYCLE_AT_MOST_MS = 24.0
"""Longest cycle of a controller that is promised from `SLOW_CYCLE_S` on; below it nothing is [ms]."""

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
"""Stations in their order, for people; all ages count from the telegram."""


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True)


class StationAges(_Frozen):
    """Ages of a robot's increments at one station.

    Attributes:
        station: for people.
        age_ms: since the telegram that the increment answers [ms].
        missing: increments that were sent and have no stamp here.
        hops: of the reference.
        reference_ms: ages after so many hops [ms]; None for a station before the first.
        ratio_p50: median by median.
        ratio_p99: p99 by p99.
    """

    station: str
    age_ms: Quantiles
    missing: int
    hops: int | None
    reference_ms: Quantiles | None
    ratio_p50: float | None
    ratio_p99: float | None


class RobotFigures(_Frozen):
    """One robot.

    Attributes:
        cycles: in the window.
        fresh: of these with a fresh admission.
        admission_rate: their share; None without cycles.
        braked: causes of the others, with their counts.
        increments: that answer cycles of the window.
        stations: ages.
        longest_client_cycle_ms: longest time from one state that its controller took to the next [ms].
    """

    cycles: int
    fresh: int
    admission_rate: float | None
    braked: dict[str, int]
    increments: int
    stations: tuple[StationAges, ...]
    longest_client_cycle_ms: float | None


class LiveRow(_Frozen):
    """One figure beside the reference of the same run, and its bound.

    Attributes:
        what: for people.
        value: of the cell; None if it could not be measured.
        unit: of value, reference and bounds.
        reference: the same of the reference.
        ratio: value by reference.
        at_most, at_least: what is promised; None for nothing.
        kept: whether it is; None where nothing is promised. What could not be measured is not kept.
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
        """The row, judged."""
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
    """The figures of one robot in a window [ns]."""
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
    """What is promised, what is compared, and what the machine itself did not get, row by row."""
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
        at for at in stamps.states[StampStation.STATE_AT_CLIENT].values() if begin_ns <= at < end_ns
    )
    gaps = [after - before for before, after in itertools.pairwise(taken)]
    return max(gaps) / 1e6 if gaps else None
