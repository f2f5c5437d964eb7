"""Why a cycle got no fresh admission: the first station that the increment of that cycle did not pass in time. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from enum import StrEnum

from deltaq_experiments.bench.journeys import RobotStamps
from deltaq_protocol.stamps import CycleOutcome, StampStation


class BrakeCause(StrEnum):
    """What kept a fresh admission from a cycle; the value is what people read."""

    HELD = "the robot was held or not ready"
    REPLY_MISSED = "the KRC had missed the reply before"
    STATE_MISSED = "the controller did not take the state before"
    NO_INCREMENT = "the controller sent no increment for it"
    CLIENT_LATE = "the controller sent its increment too late"
    ON_WAY_TO_HLI = "the increment was lost or late on its way to the HLI"
    ON_WAY_TO_GATE = "the HLI did not pass it on in time"
    NOT_DECIDED = "the gate refused it, or did not begin in time"
    GATE_LATE = "the gate had not decided in time"
    GATE_HELD = "the gate held the robot: no part of it was admissible"
    ADMISSION_LATE = "the admission was late"
    ADMISSION_LOST = "the admission was lost"
    ADMISSION_REFUSED = "the Robot Server refused the admission"


def causes(stamps: RobotStamps, cycles: Iterable[int], lookahead_cycles: int = 1) -> Counter[BrakeCause]:
    """The cause of every one of these cycles that had no fresh admission."""
    outcomes = stamps.outcomes
    missed = (cycle for cycle in cycles if outcomes.get(cycle) not in (None, CycleOutcome.FRESH))
    by_cycle = _by_cycle(stamps)
    return Counter(_cause(stamps, by_cycle, cycle, lookahead_cycles) for cycle in missed)


def _cause(
    stamps: RobotStamps,
    by_cycle: dict[StampStation, dict[int, list[int]]],
    cycle: int,
    lookahead_cycles: int,
) -> BrakeCause:
    """What a cycle needs is decided on a state before it; it has come in time if it has before the telegram."""
    if stamps.outcomes[cycle] is CycleOutcome.HELD:
        return BrakeCause.HELD
    if stamps.outcomes[cycle] is CycleOutcome.REPLY_MISSED:
        return BrakeCause.REPLY_MISSED
    before, due_ns = cycle - lookahead_cycles, stamps.states[StampStation.TELEGRAM][cycle]
    if before in stamps.admissions[StampStation.ADMISSION_OUT]:
        came_ns = stamps.admissions[StampStation.ADMISSION_AT_SERVER].get(before)
        if came_ns is None:
            return BrakeCause.ADMISSION_LOST
        decided_ns = max(by_cycle[StampStation.DECIDED].get(before, [0]))
        if decided_ns >= due_ns:
            return BrakeCause.GATE_LATE
        return BrakeCause.ADMISSION_LATE if came_ns >= due_ns else BrakeCause.ADMISSION_REFUSED
    if by_cycle[StampStation.DECIDED].get(before):
        return BrakeCause.GATE_HELD
    return _on_the_way(stamps, by_cycle, before, due_ns)


def _on_the_way(
    stamps: RobotStamps, by_cycle: dict[StampStation, dict[int, list[int]]], before: int, due_ns: int
) -> BrakeCause:
    """How far the increments that answer the state before had come; none of them was decided on that state."""
    if sent := by_cycle[StampStation.INCREMENT_OUT].get(before):
        if min(sent) >= due_ns:
            return BrakeCause.CLIENT_LATE
    elif before not in stamps.states[StampStation.STATE_AT_CLIENT]:
        return BrakeCause.STATE_MISSED
    else:
        return BrakeCause.NO_INCREMENT
    for station, cause in (
        (StampStation.INCREMENT_AT_HLI, BrakeCause.ON_WAY_TO_HLI),
        (StampStation.REQUEST_AT_GATE, BrakeCause.ON_WAY_TO_GATE),
    ):
        came = by_cycle[station].get(before)
        if not came or min(came) >= due_ns:
            return cause
    return BrakeCause.NOT_DECIDED


def _by_cycle(stamps: RobotStamps) -> dict[StampStation, dict[int, list[int]]]:
    """Times of all increments and decisions of each cycle [ns]."""
    found: dict[StampStation, dict[int, list[int]]] = {}
    for station, times in (*stamps.increments.items(), *stamps.decisions.items()):
        of_station = found.setdefault(station, {})
        for (cycle, _), at_ns in times.items():
            of_station.setdefault(cycle, []).append(at_ns)
    return found
