"""`deltaq peg-and-valve`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption


def peg_and_valve(
    cell: CellOption = "lab",
    robot: Annotated[str, typer.Option(help="A redundant robot with one hand.")] = "gr",
    mode: Annotated[
        list[str] | None, typer.Option(help="Only this mode; may be given several times.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Put in a peg and turn a valve in each mode of teleoperation, in virtual time; report time and error."""
    from deltaq_command.console import print_json, print_table
    from deltaq_command.progress import progress_bar
    from deltaq_experiments.peg_and_valve import OPERATORS, run

    with progress_bar("peg and valve") as move:
        figures = run(cell, robot, mode or tuple(OPERATORS), move)
    if json:
        print_json({"robot": robot, "modes": [one.model_dump(mode="json") for one in figures]})
        return
    rows = [
        (
            one.mode,
            f"{one.time_s:.1f}",
            f"{one.insert_s:.1f}",
            f"{one.turn_s:.1f}",
            f"{one.peg_off_mm:.1f}",
            f"{one.peg_tilt_deg:.2f}",
            f"{one.valve_off_mm:.1f}",
            f"{100 * one.limit_margin:.0f}",
        )
        for one in figures
    ]
    columns = (
        "mode",
        "task s",
        "insert s",
        "turn s",
        "peg off mm",
        "peg tilt deg",
        "valve off mm",
        "limit margin %",
    )
    print_table(f"peg and valve with {robot}", columns, rows)
