"""`deltaq health`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.errors import BAD
from deltaq_command.options import CellOption, JsonOption


def health(
    service: Annotated[str, typer.Argument(help="A service of the cell, e.g. sim or robot-server-fr.")],
    cell: CellOption = "lab",
    json: JsonOption = False,
) -> None:
    """Ask one service whether it is healthy: exit status 0 yes, 1 no, 3 no answer."""
    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json
    from deltaq_launch.probes import probe
    from deltaq_launch.services import cell_services, one

    description = load_cell(cell)
    answer = probe(one(cell_services(description, cell), service), description)
    if json:
        print_json({"service": service, "healthy": answer.healthy, "detail": answer.detail})
    else:
        typer.echo(f"{service}: {'healthy' if answer.healthy else 'not healthy'}  {answer.detail}".rstrip())
    if not answer.healthy:
        raise typer.Exit(BAD)
