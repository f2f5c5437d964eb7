"""Why a cycle got no fresh admission: the first station that its increment did not pass in time. Pure.

An increment belongs to the cycle whose setpoint it goes into. Where a cycle has none, it is missing or was late: the
one that answers the state after that which the setpoint before it answers.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable
from enum import StrEnum

from deltaq_experiments.bench.journeys import Journey, RobotStamps, goes_after, journeys_of
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
    PLACED_LATER = "the gate gave it a later setpoint"
    ADMISSION_LATE = "the admission was late"
    ADMISSION_LOST = "the admission was lost"
    ADMISSION_REFUSED = "the Robot Server refused the admission"
    CHAIN_BROKE = "it would have followed a setpoint that was missed"


def causes(stamps: RobotStamps, cycles: Iterable[int], lookahead_cycles: int = 1) -> Counter[BrakeCause]:
    """The cause of every one of these cycles that had no fresh admission."""
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
        answered = {cycle for times in stamps.increments.values() for cycle, _ in times}
        self._by_setpoint: dict[int, Journey] = {}
        self._by_cycle: dict[int, list[Journey]] = {}
        for journey in journeys_of(stamps, answered, lookahead_cycles):
            self._by_cycle.setdefault(journey.cycle, []).append(journey)
            if journey.setpoint_cycle is not None:
                self._by_setpoint[journey.setpoint_cycle] = journey
        self._setpoints = sorted(self._by_setpoint)
        decided = stamps.decisions[StampStation.DECIDED]
        self._decided_ns = {
            before + 1: decided.get(decision, 0)
            for decision, before in goes_after(stamps, lookahead_cycles).items()
        }

    def cause(self, cycle: int) -> BrakeCause:
        """Of one cycle without a fresh admission."""
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
        return cycle - 1 in self._stamps.admissions[StampStation.ADMISSION_OUT]

    def _broke_at(self, cycle: int) -> bool:
        """Whether a setpoint was missed though there was an admission for it."""
        is_fresh = self._stamps.outcomes.get(cycle) in (None, CycleOutcome.FRESH)
        return not is_fresh and self._was_admitted(cycle)

    def _of_admission(self, cycle: int) -> BrakeCause:
        due_ns = self._stamps.states[StampStation.TELEGRAM][cycle]
        came_ns = self._stamps.admissions[StampStation.ADMISSION_AT_SERVER].get(cycle - 1)
        if came_ns is None:
            return BrakeCause.ADMISSION_LOST
        if self._decided_ns.get(cycle, 0) >= due_ns:
            return BrakeCause.GATE_LATE
        return BrakeCause.ADMISSION_LATE if came_ns >= due_ns else BrakeCause.ADMISSION_REFUSED

    def _of_increment(self, cycle: int) -> BrakeCause:
        answered = self._answered_by(cycle)
        due_ns = self._stamps.states[StampStation.TELEGRAM][cycle]
        increments = self._by_cycle.get(answered, [])
        if any(one.decided_on is not None and one.setpoint_cycle is None for one in increments):
            return BrakeCause.GATE_HELD
        if not any(StampStation.INCREMENT_OUT in one.at_ns for one in increments):
            was_seen = answered in self._stamps.states[StampStation.STATE_AT_CLIENT]
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
