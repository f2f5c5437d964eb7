"""Pages of a cell's file, of the services and of the command."""

from __future__ import annotations

import typer
from typer.cli import get_docs_for_click

from deltaq_cell import description
from deltaq_cell.load import load_cell
from deltaq_deploy.command.app import app
from deltaq_deploy.command.reference.markdown import fields, models, table
from deltaq_deploy.launch.services import cell_services, console_service, demo_controllers, recorder


def cell() -> str:
    """The fields of a cell's file."""
    head = (
        "# Fields of a cell\n\nA cell is a YAML file with the fields of `CellDescription`; `deltaq check` says what is"
        " wrong with one. Units are in the names of the fields."
    )
    return "\n\n".join(
        [head, *(fields(model, level=2) for model in models(description, description.DescriptionModel))]
    )


def services() -> str:
    """The services of the lab cell, as they are started."""
    cell = load_cell("lab")
    rows = (
        (
            f"`{service.name}`",
            f"`python {' '.join(service.arguments)}`",
            ", ".join(f"`{name}`" for name in service.needs),
            ", ".join(f"{at.transport} {at.address}:{at.port}" for at in service.listens),
            service.probe,
        )
        for service in (
            *cell_services(cell, "lab"),
            console_service(cell, "lab", cell_services(cell, "lab")),
            *demo_controllers(cell),
            recorder("lab", "run.mcap"),
        )
    )
    return (
        "# Services\n\nThe lab cell's, as `deltaq up` starts them; leader and follower belong to `deltaq demo`, the"
        " console is left out by `--no-console`, the recorder belongs to `deltaq up --record`. Each"
        " prints one line that begins with `ready:` once it serves.\n\n"
        + table(("service", "command", "starts after", "listens on", "asked for health by"), rows)
    )


def cli() -> str:
    """The command's help, as typer renders it."""
    command = typer.main.get_command(app)
    text = get_docs_for_click(
        obj=command, ctx=typer.Context(command), name="deltaq", title="The deltaq command"
    )
    exits = (
        "Exit status: 0 done, 1 the thing reported is bad, 2 wrong usage or configuration, 3 a service could not be"
        " reached.\n\n**Usage**"
    )
    return text.replace("**Usage**", exits, 1)
