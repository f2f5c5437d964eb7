"""The verb that makes identities: one for each service of a cell, its operators and its controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deltaq_command.options import JsonOption

KEEP = (
    "Who has its key can make identities of this cell: take the folder off this machine, and bring it back for "
    "the next `deltaq keys`"
)


def keys(
    cell: Annotated[str, typer.Argument(help="Name of a shipped cell or path of a YAML file.")],
    to: Annotated[Path, typer.Option("--to", metavar="FOLDER", help="Folder for the identities.")],
    operator: Annotated[
        list[str] | None,
        typer.Option("--operator", metavar="NAME", help="Make an identity for this operator; repeatable."),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            "--controller", metavar="NAME", help="Make an identity for this controller; repeatable."
        ),
    ] = None,
    authority: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the authority's key.",
            show_default="authority in the folder of --to",
        ),
    ] = None,
    days: Annotated[
        int, typer.Option(min=1, max=3650, help="Days for which the identities are valid.")
    ] = 730,
    json: JsonOption = False,
) -> None:
    """Make an authority for a cell, and an identity for each of its services, operators and controllers.

    Each identity is a folder for the machine that needs it. The command makes what is missing, and writes nothing over.
    """
    from datetime import timedelta

    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json
    from deltaq_protocol.certified.authority import make_identities
    from deltaq_protocol.certified.certificate import now_utc
    from deltaq_protocol.certified.names import IDENTITY, IdentityKind, name_of
    from deltaq_protocol.sayings import services

    description = load_cell(cell)
    people = [name_of(IdentityKind.OPERATOR, name) for name in operator or ()]
    people += [name_of(IdentityKind.CONTROLLER, name) for name in controller or ()]
    of_cell = [name_of(IdentityKind.SERVICE, name) for name in services(tuple(description.robots))]
    made = make_identities(
        description.cell, to, of_cell, dict.fromkeys(people), now_utc(), authority, timedelta(days=days)
    )
    if json:
        print_json(
            {
                "cell": description.cell,
                "authority": str(made.authority),
                "authority_is_new": made.is_new,
                "made": {name: str(to / name) for name in made.made},
                "kept": list(made.kept),
                "valid_until": f"{made.valid_until:%Y-%m-%dT%H:%M:%SZ}",
            }
        )
        return
    for name in made.made:
        typer.echo(f"{to / name}: {name} of cell {description.cell}")
    for name in made.kept:
        typer.echo(f"{name}: made before, and not again")
    if made.made:
        typer.echo(f"valid until {made.valid_until:%Y-%m-%d}; on each machine {IDENTITY} names its folder")
    typer.echo(f"{made.authority}: the authority. {KEEP}")
