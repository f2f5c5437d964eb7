"""`deltaq dry-run`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption, RobotOption


def dry_run(
    robot: RobotOption,
    dq: Annotated[
        str,
        typer.Option(metavar="DQ,DQ,...", help="Increment of one cycle, a number for each joint [rad or m]."),
    ],
    cell: CellOption = "lab",
    json: JsonOption = False,
) -> None:
    """Ask for the gate's verdict on an increment; nothing moves. Exit status 1 unless it would be admitted whole."""
    import math

    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json
    from deltaq_launch.cell_connection import connect, known_robot
    from deltaq_protocol.messages import Outcome

    try:
        increment = [float(number) for number in dq.split(",")]
    except ValueError:
        increment = []
    if not increment or not all(map(math.isfinite, increment)):
        raise typer.BadParameter(f"finite numbers with commas between them, got {dq!r}", param_hint="--dq")
    description = load_cell(cell)
    known_robot(description, robot)
    with connect(description, "deltaq dry-run") as running:
        verdict = running.dry_run(robot, increment)
    if json:
        print_json(verdict.model_dump(mode="json"))
    else:
        typer.echo(
            f"{verdict.outcome}, {verdict.scale:.0%} of it; it would stop within {verdict.time_to_stop_s:g} s"
        )
        for reason in verdict.reasons:
            typer.echo(
                f"  {reason.code}: {reason.what} {_number(reason.value)} (bound {_number(reason.bound)})"
            )
        if verdict.clearance_m is not None and verdict.pair is not None:
            typer.echo(f"  nearest: {' and '.join(verdict.pair)}, {verdict.clearance_m:.3f} m apart")
    if verdict.outcome is not Outcome.ADMITTED:
        raise typer.Exit(1)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
