"""The table of faults: produced in virtual time or live, and as people read it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from deltaq_testing.faults.catalogue import CATALOGUE, Fault, UnknownFaultError
from deltaq_testing.faults.mover import CRUISE_RAD_S
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.faults.report import FaultEffect, FaultTable
from deltaq_testing.faults.virtual import run_fault

COLUMNS = (
    "fault",
    "braked after [cycles]",
    "at rest after [ms]",
    "travel [deg]",
    "tool [mm]",
    "phase",
    "reason",
    "named after [ms]",
    "KRC cycles unanswered",
    "abrupt",
    "clearance [mm]",
    "moves again",
    "good",
)
GOES_ON = "goes on"


def run_table(
    cell_name: str | Path = "lab",
    robot: str | None = None,
    *,
    faults: Sequence[Fault] = CATALOGUE,
    live: bool = False,
    seed: int = 0,
    on_row: Callable[[int, int], None] | None = None,
) -> FaultTable:
    """Let one robot suffer fault after fault.

    Args:
        cell_name: name or file of a cell whose robots are driven over RSI.
        robot: the one that moves; None for the first of the cell.
        faults: from the catalogue; those that cannot be had this way, live or in virtual time, are left out.
        live: over real processes, zenoh and UDP.
        seed: of the wires' random numbers.
        on_row: called with the number of rows done and the number of all.

    Raises:
        UnknownFaultError: if the robot is not the cell's, or no fault is left to be run.
    """
    loaded = load_rsi_cell(cell_name, robot)
    name = robot or next(iter(loaded.model.robots))
    chosen = [fault for fault in faults if (fault.live if live else fault.virtual)]
    if not chosen:
        way, other = ("live", "leave out") if live else ("in virtual time", "add")
        raise UnknownFaultError(f"none of these faults can be had {way}; {other} --live")
    rows: list[FaultEffect] = []
    order = {fault.name: place for place, fault in enumerate(chosen)}

    def add(row: FaultEffect) -> None:
        rows.append(row)
        if on_row is not None:
            on_row(len(rows), len(chosen))

    if live:
        from deltaq_testing.faults.live import run_live_faults

        run_live_faults(chosen, loaded, name, add, seed)
    else:
        for fault in chosen:
            add(run_fault(fault, loaded, name, seed))
    return FaultTable(
        cell=loaded.model.description.cell,
        robot=name,
        cycle_s=loaded.model.description.cycle_s,
        cruise_rad_s=float(CRUISE_RAD_S),
        rows=tuple(sorted(rows, key=lambda row: order[row.fault])),
    )


def shown(row: FaultEffect) -> tuple[str, ...]:
    """A row under `COLUMNS`, for people: degrees and millimetres."""
    motion, kept = row.motion, row.kept
    if motion.rest_after_s is None or motion.travel_rad is None or motion.travel_tool_m is None:
        until_rest = (GOES_ON, "-", "-")
    else:
        until_rest = (
            f"{motion.rest_after_s * 1000:.0f}",
            f"{math.degrees(motion.travel_rad):.2f}",
            f"{motion.travel_tool_m * 1000:.1f}",
        )
    return (
        row.fault,
        "-" if motion.braked_after_cycles is None else str(motion.braked_after_cycles),
        *until_rest,
        row.phase,
        row.reason or "-",
        "-" if row.named_after_s is None else f"{row.named_after_s * 1000:.0f}",
        str(kept.unanswered_cycles),
        str(kept.abrupt_cycles),
        f"{kept.clearance_m * 1000:.0f}",
        row.recovery,
        "yes" if row.good else "no",
    )


def markdown(table: FaultTable) -> str:
    """The table for a page of the documentation."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *map(shown, table.rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
