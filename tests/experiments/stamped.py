"""Stamps of one robot's increments, made up in milliseconds."""

from deltaq_experiments.bench.journeys import OF_ADMISSION, OF_DECISION, OF_INCREMENT, RobotStamps
from deltaq_protocol.stamps import CycleOutcome, StampStation

MS = 1_000_000
CYCLE_MS = 12.0
WAY_MS = {
    StampStation.TELEGRAM: 0.0,
    StampStation.STATE_OUT: 1.0,
    StampStation.STATE_AT_CLIENT: 2.0,
    StampStation.INCREMENT_OUT: 3.0,
    StampStation.INCREMENT_AT_HLI: 4.0,
    StampStation.REQUEST_AT_GATE: 5.0,
    StampStation.DECISION_BEGUN: 6.0,
    StampStation.DECIDED: 7.0,
    StampStation.ADMISSION_OUT: 8.0,
    StampStation.ADMISSION_AT_SERVER: 9.0,
}


def stamp(
    stamps: RobotStamps,
    cycle: int,
    *,
    seq: int | None = None,
    outcome: CycleOutcome = CycleOutcome.FRESH,
    without: tuple[StampStation, ...] = (),
    later_ms: dict[StampStation, float] | None = None,
    decided_on: int | None = None,
    setpoint_cycle: int | None = None,
) -> None:
    """The stamps of a cycle and of the increment that answers it, without some, and with some later than usual.

    It is decided on the state that it answers, and goes into the setpoint of the cycle after, if nothing else is told.
    """
    for station, usual_ms in WAY_MS.items():
        if station in without:
            continue
        at_ms = CYCLE_MS * cycle + usual_ms + (later_ms or {}).get(station, 0.0)
        named = cycle
        if station in (*OF_DECISION, *OF_ADMISSION):
            named = cycle if decided_on is None else decided_on
        if station in OF_ADMISSION and setpoint_cycle is not None:
            named = setpoint_cycle - 1
        numbered = station in (*OF_INCREMENT, *OF_DECISION)
        detail = (cycle if seq is None else seq) if numbered else int(outcome)
        stamps.add(station, named, detail, round(at_ms * MS))


def ns(cycle: float) -> int:
    """Begin of a cycle [ns]."""
    return round(cycle * CYCLE_MS * MS)
