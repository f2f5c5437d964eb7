"""`deltaq soak`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption
from deltaq_launch.exit_status import BAD


def soak(
    hours: Annotated[float, typer.Option(min=0.001, max=80.0, help="Duration of the soak.")],
    to: Annotated[Path, typer.Option(help="Folder for soak.json and soak.png; made if it does not exist.")],
    cell: CellOption = "lab",
    robot: Annotated[
        str | None, typer.Option(help="The robot that moves; by default the cell's first.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults and their times.")] = 0,
    json: JsonOption = False,
) -> None:
    """Inject fault after fault into a cell of real processes; Ctrl-C ends the soak and writes the report so far."""
    import tempfile

    from deltaq_command.console import print_json
    from deltaq_testing.scenario.write import must_be_folder, write_report
    from deltaq_testing.soak import SoakRound, run_soak
    from deltaq_testing.soak_figure import figure_of

    def tell(one: SoakRound) -> None:
        found = "good" if one.good else f"not good: {one.clear}; {one.limits}; recovered: {one.recovered}"
        if not json:
            typer.echo(f"{one.time_s:8.1f} s  {one.fault}: {found}")

    must_be_folder(to)
    with tempfile.TemporaryDirectory() as folder:
        report = run_soak(Path(folder), cell, robot, hours * 3600.0, seed, tell)
    write_report(to / "soak.json", report.model_dump_json(indent=1) + "\n")
    figure_of(report).savefig(to / "soak.png", dpi=120)
    good = sum(one.good for one in report.rounds)
    if json:
        counts = {"rounds": len(report.rounds), "good_rounds": good}
        print_json({"good": report.good, **counts, "length_s": report.length_s})
    else:
        typer.echo(
            f"{good} of {len(report.rounds)} faults were good in {report.length_s:.0f} s; {to / 'soak.json'}"
        )
    if not report.good:
        raise typer.Exit(BAD)
