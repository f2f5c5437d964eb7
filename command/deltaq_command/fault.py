"""`deltaq fault`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_command.fault_scenarios import run, search
from deltaq_command.impair import impair
from deltaq_command.options import CellOption, JsonOption, RobotOption
from deltaq_launch.exit_status import BAD

if TYPE_CHECKING:
    from deltaq_verification.faults.catalogue import Fault

fault = typer.Typer(
    help="Inject faults into a moving robot, and report which limits were kept.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
fault.command()(impair)
fault.command()(run)
fault.command()(search)


@fault.command("list")
def list_faults(json: JsonOption = False) -> None:
    """List all faults."""
    from deltaq_command.console import print_json, print_table
    from deltaq_verification.faults.catalogue import CATALOGUE

    if json:
        rows = (
            {
                "name": row.name,
                "what": row.what,
                "virtual": row.virtual,
                "live": row.live,
                "injectable": row.injectable,
            }
            for row in CATALOGUE
        )
        print_json({"faults": list(rows)})
        return
    columns = ("fault", "what happens", "table", "table --live", "inject")
    print_table("faults", columns, ((row.name, row.what, *_ways(row)) for row in CATALOGUE))


@fault.command()
def table(
    names: Annotated[list[str] | None, typer.Argument(help="Faults to inject; all if none is given.")] = None,
    cell: CellOption = "lab",
    robot: Annotated[
        str | None, typer.Option(help="The robot that moves; by default the cell's first.")
    ] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Run over real processes, zenoh and UDP; the cell must not be up already."
        ),
    ] = False,
    seed: Annotated[
        int,
        typer.Option(
            min=0, help="Seed of the links' faults; in virtual time the same seed gives the same run."
        ),
    ] = 0,
    json: JsonOption = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a table for a document.")] = False,
) -> None:
    """Inject faults into a moving robot, one by one; exit status 1 if a limit was passed or it never moved again."""
    from deltaq_command.console import print_json, print_table
    from deltaq_command.progress import progress_bar
    from deltaq_verification.faults import table as fault_table
    from deltaq_verification.faults.catalogue import CATALOGUE, fault_named

    chosen = [fault_named(name) for name in names] if names else CATALOGUE
    with progress_bar("faults" + (" live" if live else "")) as progress:
        result = fault_table.run_table(cell, robot, faults=chosen, live=live, seed=seed, on_row=progress)
    if json:
        print_json(result.model_dump(mode="json") | {"good": result.good})
    elif markdown:
        typer.echo(fault_table.markdown(result))
    else:
        title = f"faults of {result.robot} in cell {result.cell}" + (
            ", live" if live else ", in virtual time"
        )
        print_table(title, fault_table.COLUMNS, map(fault_table.shown, result.rows))
    if not result.good:
        raise typer.Exit(BAD)


@fault.command()
def inject(
    name: Annotated[str, typer.Argument(help="A fault that `deltaq fault list` shows as injectable.")],
    robot: RobotOption,
    cell: CellOption = "lab",
    for_s: Annotated[
        float, typer.Option(min=0.0, help="Duration of a fault that does not end by itself.")
    ] = 1.0,
    json: JsonOption = False,
) -> None:
    """Inject a fault into a running emulated cell, through the panel of the robot's emulated controller."""
    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json
    from deltaq_launch.cell_connection import known_robot
    from deltaq_verification.faults.catalogue import fault_named
    from deltaq_verification.faults.inject import inject as run

    description = load_cell(cell)
    known_robot(description, robot)
    result = run(fault_named(name), description, robot, for_s)
    if json:
        print_json(result.model_dump(mode="json"))
        return
    reason = f" ({result.reason})" if result.reason else ""
    message = f"; on the pendant: {result.krc_message}" if result.krc_message else ""
    typer.echo(f"{name}: {robot} is {result.phase}{reason}, its controller: {result.krc_state}{message}")


def _ways(row: Fault) -> tuple[str, ...]:
    return tuple("yes" if way else "-" for way in (row.virtual, row.live, row.injectable))
