"""Journey of each increment through the cell, joined from the stamps of all processes.

Pure. Robot and cycle join a state with the increment that answers it; its sequence number joins the increment with the
decision on it. The gate does one thing after the other, so an admission that goes out after a decision has begun and
before the next one belongs to it; the cycle whose setpoint it goes into joins its stamps. Any stamp may be missing.
"""

from bisect import bisect_left
from collections import defaultdict
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
"""Stations of an admission, stamped with the cycle before that of its setpoint."""


@dataclass
class RobotStamps:
    """All stamps of one robot.

    Attributes:
        of_cycle: time of each cycle at the stations of a state and of an admission [ns]; an admission is stamped with
            the cycle before that of its setpoint.
        of_number: time of each (cycle, sequence number) at the stations of an increment and of a decision [ns].
        outcomes: kind of setpoint in each cycle.
    """

    of_cycle: dict[StampStation, dict[int, int]] = field(default_factory=lambda: defaultdict(dict))
    of_number: dict[StampStation, dict[tuple[int, int], int]] = field(
        default_factory=lambda: defaultdict(dict)
    )
    outcomes: dict[int, CycleOutcome] = field(default_factory=dict)

    def add(self, station: StampStation, cycle: int, detail: int, time_ns: int) -> None:
        """Add a stamp; of two of one kind the first counts."""
        if station in (*OF_INCREMENT, *OF_DECISION):
            self.of_number[station].setdefault((cycle, detail), time_ns)
            return
        self.of_cycle[station].setdefault(cycle, time_ns)
        if station is StampStation.STATE_OUT:
            self.outcomes.setdefault(cycle, CycleOutcome(detail))

    def cycles_in(self, begin_ns: int, end_ns: int) -> list[int]:
        """Cycles whose telegram came within a window, in order."""
        telegrams = self.of_cycle[StampStation.TELEGRAM]
        return sorted(cycle for cycle, at_ns in telegrams.items() if begin_ns <= at_ns < end_ns)


@dataclass(frozen=True)
class Journey:
    """One increment.

    Attributes:
        cycle: the cycle that it answers.
        seq: its sequence number.
        decided_on: cycle of the state that it was decided on; None if it was not decided.
        setpoint_cycle: the cycle that it goes into; None if there is no admission of it.
        at_ns: when it passed each station, without those that it did not pass [ns].
    """

    cycle: int
    seq: int
    decided_on: int | None
    setpoint_cycle: int | None
    at_ns: dict[StampStation, int]

    def age_ns(self, station: StampStation) -> int | None:
        """Time at a station since the telegram that it answers [ns]; None if either stamp is missing."""
        begin_ns, at_ns = self.at_ns.get(StampStation.TELEGRAM), self.at_ns.get(station)
        return None if begin_ns is None or at_ns is None else at_ns - begin_ns


def by_robot(written: Iterable[WrittenStamps]) -> dict[str, RobotStamps]:
    """The stamps of all processes, by robot."""
    robots: dict[str, RobotStamps] = {}
    for one in written:
        for station, index, cycle, detail, time_ns in one.rows.tolist():
            stamps = robots.setdefault(one.robots[index], RobotStamps())
            stamps.add(StampStation(station), cycle, detail, time_ns)
    return robots


def journeys(stamps: RobotStamps, begin_ns: int, end_ns: int, lookahead_cycles: int = 1) -> list[Journey]:
    """Every increment that answers a telegram of the window, in the order of cycles.

    An increment counts if any process has stamped it. Where its telegram's stamp is missing it has no age, and is left
    out.
    """
    return journeys_of(stamps, stamps.cycles_in(begin_ns, end_ns), lookahead_cycles)


def journeys_of(stamps: RobotStamps, cycles: Iterable[int], lookahead_cycles: int = 1) -> list[Journey]:
    """Every increment that answers one of these cycles."""
    answered = set(cycles)
    decided_on, placed = _decided_on(stamps), goes_after(stamps, lookahead_cycles)
    keys = {key for station in OF_INCREMENT for key in stamps.of_number[station] if key[0] in answered}
    return [_journey(stamps, *key, decided_on.get(key), placed) for key in sorted(keys)]


def _journey(
    stamps: RobotStamps,
    cycle: int,
    seq: int,
    decided_on: int | None,
    placed: dict[tuple[int, int], int],
) -> Journey:
    passed = [(s, stamps.of_cycle[s].get(cycle)) for s in OF_STATE]
    passed += [(s, stamps.of_number[s].get((cycle, seq))) for s in OF_INCREMENT]
    setpoint_cycle = None
    if decided_on is not None:
        passed += [(s, stamps.of_number[s].get((decided_on, seq))) for s in OF_DECISION]
        if (before := placed.get((decided_on, seq))) is not None:
            passed += [(s, stamps.of_cycle[s].get(before)) for s in OF_ADMISSION]
            setpoint_cycle = before + 1
    at_ns = {s: at_ns for s, at_ns in passed if at_ns is not None}
    return Journey(cycle, seq, decided_on, setpoint_cycle, at_ns)


def goes_after(stamps: RobotStamps, lookahead_cycles: int) -> dict[tuple[int, int], int]:
    """By decision (cycle of the state, sequence number), the cycle before that of its setpoint."""
    out = sorted((at_ns, cycle) for cycle, at_ns in stamps.of_cycle[StampStation.ADMISSION_OUT].items())
    begun = sorted((at_ns, key) for key, at_ns in stamps.of_number[StampStation.DECISION_BEGUN].items())
    at_server = stamps.of_cycle[StampStation.ADMISSION_AT_SERVER]
    found: dict[tuple[int, int], int] = {}
    for index, (begun_ns, key) in enumerate(begun):
        end_ns = begun[index + 1][0] if index + 1 < len(begun) else None
        first = bisect_left(out, (begun_ns, -1))
        usual = key[0] + lookahead_cycles - 1
        if first < len(out) and (end_ns is None or out[first][0] < end_ns):
            found[key] = out[first][1]
        elif usual in at_server and usual not in stamps.of_cycle[StampStation.ADMISSION_OUT]:
            found[key] = usual  # the stamp of its going out was lost
    return found


def _decided_on(stamps: RobotStamps) -> dict[tuple[int, int], int]:
    """The cycle of the state that each increment was decided on.

    Sequence numbers restart with each lease, so a decision belongs to the last request of its number before it.
    """
    requests: dict[int, list[tuple[int, int]]] = {}
    for (cycle, seq), at_ns in stamps.of_number[StampStation.REQUEST_AT_GATE].items():
        requests.setdefault(seq, []).append((at_ns, cycle))
    found = {}
    for (decided_on, seq), begun_ns in stamps.of_number[StampStation.DECISION_BEGUN].items():
        before = [(at_ns, cycle) for at_ns, cycle in requests.get(seq, []) if at_ns <= begun_ns]
        if before:
            found[max(before)[1], seq] = decided_on
    return found
