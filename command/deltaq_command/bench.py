"""`deltaq bench`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.errors import BAD
from deltaq_command.options import CellOption, JsonOption


def bench(
    cell: CellOption = "lab",
    cycles: Annotated[int, typer.Option(min=10, help="Cycles of tracking that are timed.")] = 400,
    json: JsonOption = False,
) -> None:
    """Measure against references in the same run; exit status 1 if a median is beyond its bound."""
    import sys

    from rich.progress import Progress

    from deltaq_command.console import console, print_json, print_table
    from deltaq_experiments.bench import run

    output = console(sys.stderr)
    with Progress(console=output, transient=True, disable=not output.is_terminal) as progress:
        task = progress.add_task("tracking", total=cycles)
        table = run(cell, cycles, lambda done, _: progress.update(task, completed=done))
    if json:
        print_json(table.model_dump(mode="json") | {"good": table.good})
    else:
        columns = ("what", "reference", "median µs", "reference µs", "ratio", "p99 ratio", "at most")
        print_table(
            "figures as ratios",
            columns,
            (
                (
                    row.what,
                    row.reference,
                    f"{row.median_us:.0f}",
                    f"{row.reference_us:.0f}",
                    f"{row.median_ratio:.2f}",
                    f"{row.p99_ratio:.2f}",
                    f"{row.at_most:g}",
                )
                for row in table.rows
            ),
        )
    if not table.good:
        raise typer.Exit(BAD)
