"""`deltaq check`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.errors import BAD
from deltaq_command.options import JsonOption


def check(
    cell: Annotated[str, typer.Argument(help="Name of a shipped cell or path of a YAML file.")],
    json: JsonOption = False,
) -> None:
    """Check the description of a cell; name file, line, field, value and bound of every error.

    It also lists which bodies of a robot are never checked against which, and why.
    """
    from deltaq_cell.check import check_cell
    from deltaq_cell.never_checked import Why
    from deltaq_command.console import print_json

    report = check_cell(cell)
    if json:
        print_json(report.as_dict())
    else:
        for problem in report.problems:
            typer.echo(f"{problem.severity}: {problem}")
        if not report.problems:
            typer.echo(f"{cell}: good")
        for robot, pairs in report.never_checked.items():
            for why in dict.fromkeys(pairs.values()):
                if why is Why.ONE_LINK:  # dozens where a gripper is modelled in parts; --json names them
                    typer.echo(
                        f"{robot}: never checked, since {why}: {list(pairs.values()).count(why)} pairs"
                    )
                    continue
                named = [
                    " - ".join(name.removeprefix(f"{robot}/") for name in p) for p in pairs if pairs[p] is why
                ]
                typer.echo(f"{robot}: never checked, since {why}: {', '.join(named)}")
    if not report.ok:
        raise typer.Exit(BAD)
