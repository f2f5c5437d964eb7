"""The table of faults: produced in virtual time, and as people read it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from deltaq_testing.faults.catalogue import CATALOGUE, Fault, UnknownFaultError
from deltaq_testing.faults.mover import CRUISE_RAD_S
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.faults.report import FaultEffect, FaultTable
from deltaq_testing.faults.virtual import run_fault
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

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
    seed: int = 0,
    on_row: Callable[[int, int], None] | None = None,
) -> FaultTable:
    """Inject fault after fault in virtual time while one robot moves.

    Args:
        cell_name: name or file of a cell whose robots are driven over RSI.
        robot: the moving robot; None for the first of the cell.
        faults: from the catalogue; those that are not possible in virtual time are left out.
        seed: of the wires' random numbers.
        on_row: called with the number of rows done and the number of all.

    Raises:
        UnknownFaultError: if the robot is not the cell's, or no fault is left to be run.
    """
    loaded = load_rsi_cell(cell_name, robot)
    name = robot or next(iter(loaded.model.robots))
    chosen = [fault for fault in faults if fault.virtual]
    if not chosen:
        raise UnknownFaultError(
            "none of these faults is possible in virtual time; `deltaq fault list` shows which can"
        )
    rows: list[FaultEffect] = []
    for fault in chosen:
        rows.append(run_fault(fault, loaded, name, seed))
        if on_row is not None:
            on_row(len(rows), len(chosen))
    return table_of(loaded, name, rows)


def table_of(loaded: LoadedCell, robot: str, rows: Sequence[FaultEffect]) -> FaultTable:
    """The rows of a robot as a table."""
    return FaultTable(
        cell=loaded.model.description.cell,
        robot=robot,
        cycle_s=loaded.model.description.cycle_s,
        cruise_rad_s=float(CRUISE_RAD_S),
        rows=tuple(rows),
    )


def shown(row: FaultEffect) -> tuple[str, ...]:
    """A row under `COLUMNS` as text, in degrees and millimetres."""
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
