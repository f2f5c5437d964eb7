"""The way of each increment through the cell, joined from the stamps of all processes.

Pure. Robot and cycle join a state with the increment that answers it; its sequence number joins the increment with the
decision on it; the cycle of the state that was decided on joins the decision with its admission, which is taken in the
cycle after. Any stamp may be missing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from deltaq_protocol.stamps import CycleOutcome, StampStation, WrittenStamps

OF_STATE = (StampStation.TELEGRAM, StampStation.STATE_OUT, StampStation.STATE_AT_CLIENT)
"""Stations of a state, stamped with its cycle."""
OF_INCREMENT = (StampStation.INCREMENT_OUT, StampStation.INCREMENT_AT_HLI, StampStation.REQUEST_AT_GATE)
"""Stations of an increment, stamped with the cycle that it answers and its sequence number."""
OF_DECISION = (StampStation.DECISION_BEGUN, StampStation.DECIDED)
"""Stations of a decision, stamped with the cycle of the state that it was made on and the sequence number."""
OF_ADMISSION = (StampStation.ADMISSION_OUT, StampStation.ADMISSION_AT_SERVER)
"""Stations of an admission, stamped with the cycle of the state that it was decided on."""


@dataclass
class RobotStamps:
    """All stamps of one robot.

    Attributes:
        states: time of each cycle at each station of a state [ns].
        increments: time of each (cycle, sequence number) at each station of an increment [ns].
        decisions: time of each (cycle, sequence number) at each station of a decision [ns].
        admissions: time of each cycle at each station of an admission [ns].
        outcomes: what the robot was sent in each cycle.
    """

    states: dict[StampStation, dict[int, int]] = field(default_factory=lambda: {s: {} for s in OF_STATE})
    increments: dict[StampStation, dict[tuple[int, int], int]] = field(
        default_factory=lambda: {s: {} for s in OF_INCREMENT}
    )
    decisions: dict[StampStation, dict[tuple[int, int], int]] = field(
        default_factory=lambda: {s: {} for s in OF_DECISION}
    )
    admissions: dict[StampStation, dict[int, int]] = field(
        default_factory=lambda: {s: {} for s in OF_ADMISSION}
    )
    outcomes: dict[int, CycleOutcome] = field(default_factory=dict)

    def add(self, station: StampStation, cycle: int, detail: int, time_ns: int) -> None:
        """Add a stamp; of two of one kind the first counts."""
        if station in self.states:
            self.states[station].setdefault(cycle, time_ns)
            if station is StampStation.STATE_OUT:
                self.outcomes.setdefault(cycle, CycleOutcome(detail))
        elif station in self.increments:
            self.increments[station].setdefault((cycle, detail), time_ns)
        elif station in self.decisions:
            self.decisions[station].setdefault((cycle, detail), time_ns)
        else:
            self.admissions[station].setdefault(cycle, time_ns)

    def cycles_in(self, begin_ns: int, end_ns: int) -> list[int]:
        """Cycles whose telegram came within a window, in order."""
        telegrams = self.states[StampStation.TELEGRAM]
        return sorted(cycle for cycle, at_ns in telegrams.items() if begin_ns <= at_ns < end_ns)


@dataclass(frozen=True)
class Journey:
    """One increment.

    Attributes:
        cycle: that it answers.
        seq: its sequence number.
        decided_on: cycle of the state that it was decided on; None if it was not decided.
        at_ns: when it passed each station, without those that it did not pass [ns].
    """

    cycle: int
    seq: int
    decided_on: int | None
    at_ns: dict[StampStation, int]

    def age_ns(self, station: StampStation) -> int | None:
        """Time at a station since the telegram that it answers [ns]; None if either stamp is missing."""
        begin_ns, at_ns = self.at_ns.get(StampStation.TELEGRAM), self.at_ns.get(station)
        return None if begin_ns is None or at_ns is None else at_ns - begin_ns


def by_robot(written: Iterable[WrittenStamps], lookahead_cycles: int = 1) -> dict[str, RobotStamps]:
    """The stamps of all processes, by robot; those of admissions under the state whose answers go into them."""
    robots: dict[str, RobotStamps] = {}
    for one in written:
        for station, index, cycle, detail, time_ns in one.rows.tolist():
            stamps = robots.setdefault(one.robots[index], RobotStamps())
            answered = cycle - lookahead_cycles + 1 if station in OF_ADMISSION else cycle
            stamps.add(StampStation(station), answered, detail, time_ns)
    return robots


def journeys(stamps: RobotStamps, begin_ns: int, end_ns: int) -> list[Journey]:
    """Every increment that answers a telegram of the window, in the order of cycles.

    An increment counts if any process has stamped it. Where its telegram's stamp is missing it has no age, and is left
    out.
    """
    cycles = set(stamps.cycles_in(begin_ns, end_ns))
    decided_on = _decided_on(stamps)
    keys = {key for station in OF_INCREMENT for key in stamps.increments[station] if key[0] in cycles}
    return [_journey(stamps, cycle, seq, decided_on.get((cycle, seq))) for cycle, seq in sorted(keys)]


def _journey(stamps: RobotStamps, cycle: int, seq: int, decided_on: int | None) -> Journey:
    passed = [(s, stamps.states[s].get(cycle)) for s in OF_STATE]
    passed += [(s, stamps.increments[s].get((cycle, seq))) for s in OF_INCREMENT]
    if decided_on is not None:
        passed += [(s, stamps.decisions[s].get((decided_on, seq))) for s in OF_DECISION]
        passed += [(s, stamps.admissions[s].get(decided_on)) for s in OF_ADMISSION]
    return Journey(cycle, seq, decided_on, {s: at_ns for s, at_ns in passed if at_ns is not None})


def _decided_on(stamps: RobotStamps) -> dict[tuple[int, int], int]:
    """The cycle of the state that each increment was decided on.

    Sequence numbers begin anew with each lease, so a decision belongs to the last request of its number before it.
    """
    requests: dict[int, list[tuple[int, int]]] = {}
    for (cycle, seq), at_ns in stamps.increments[StampStation.REQUEST_AT_GATE].items():
        requests.setdefault(seq, []).append((at_ns, cycle))
    found = {}
    for (decided_on, seq), begun_ns in stamps.decisions[StampStation.DECISION_BEGUN].items():
        before = [(at_ns, cycle) for at_ns, cycle in requests.get(seq, []) if at_ns <= begun_ns]
        if before:
            found[max(before)[1], seq] = decided_on
    return found
