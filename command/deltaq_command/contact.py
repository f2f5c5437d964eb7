"""`deltaq contact`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption, TokenOption


def contact(
    name: Annotated[str | None, typer.Argument(help="A contact of the cell; none: list them.")] = None,
    forbid: Annotated[bool, typer.Option("--forbid", help="Keep its bodies apart again.")] = False,
    cell: CellOption = "lab",
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Allow a contact of the cell, at its own low speed, or list the contacts."""
    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json
    from deltaq_launch.cell_connection import connect

    description = load_cell(cell)
    with connect(description, "deltaq contact", token) as running:
        done = running.allow_contact(name, not forbid) if name is not None else None
        allowed = running.status().contacts
    if json:
        told = {"contacts": {each: each in allowed for each in description.contacts}}
        print_json(done.model_dump(mode="json") if done else told)
    elif done is not None:
        typer.echo(done.what)
    else:
        for each, its in description.contacts.items():
            touching = f"{', '.join(its.bodies)} with {', '.join(its.against)}"
            typer.echo(f"{each}: {'allowed' if each in allowed else 'forbidden'} ({touching})")
        if not description.contacts:
            typer.echo(f"{description.cell} has no contacts; they are described under `contacts` in its YAML")
