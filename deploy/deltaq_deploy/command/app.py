"""The command and its verbs.

A file of verbs imports heavy packages (pinocchio, zenoh, matplotlib) inside its function, so that help and
completion are quick.
"""

from __future__ import annotations

from importlib.metadata import version as version_of
from typing import Annotated, Any

import typer
from pydantic import ValidationError
from typer.core import TyperGroup

from deltaq_deploy.command import (
    advise,
    demo,
    drive,
    fault,
    installation,
    krc,
    operate,
    recordings,
    run,
    streams,
    study,
    up,
    watch,
)

# The group of verbs: an option that is refused is told with the value that was given, beside its name and
# bound.


class Verbs(TyperGroup):
    """typer's group, whose own words name option and bound alone."""

    def invoke(self, ctx: Any) -> Any:  # typer keeps the class of its contexts to itself
        """Run a verb.

        Raises:
            typer.BadParameter: an option is not what it may be.
        """
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            if isinstance(error.__cause__, ValidationError):
                first, *_ = error.__cause__.errors()
                error.message = f"{error.message}, got {first['input']!r}"
            raise


RUN = "Run a cell"
WATCH = "Look at a running cell"
COMMAND = "Command a running cell"
STUDY = "Study and check"
REAL = "Real robots"

app = typer.Typer(
    cls=Verbs,
    help="A networked control server for industrial manipulators: any controller, one safety gate.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"deltaq {version_of('deltaq')}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version, and exit."
        ),
    ] = False,
) -> None:
    pass


app.command(rich_help_panel=RUN)(up.up)
app.command(rich_help_panel=RUN)(demo.demo)
app.command(rich_help_panel=RUN)(installation.key)
app.command(rich_help_panel=RUN)(installation.keys)
app.command(rich_help_panel=WATCH)(watch.status)
app.command(rich_help_panel=WATCH)(watch.top)
app.command(rich_help_panel=WATCH)(streams.echo)
app.command(rich_help_panel=WATCH)(streams.hz)
app.command(rich_help_panel=WATCH)(watch.health)
app.command(rich_help_panel=WATCH)(recordings.record)
app.command(rich_help_panel=WATCH)(watch.metrics)
app.command(rich_help_panel=WATCH)(watch.ros2)
app.command(rich_help_panel=WATCH)(watch.audit)
app.command(rich_help_panel=COMMAND)(drive.drive)
app.command(rich_help_panel=COMMAND)(run.run)
app.command(rich_help_panel=COMMAND)(operate.follow)
app.command(rich_help_panel=COMMAND)(operate.view)
app.command(rich_help_panel=COMMAND)(advise.advise)
app.command(rich_help_panel=COMMAND)(operate.stop)
app.command(rich_help_panel=COMMAND)(operate.reset)
app.command(rich_help_panel=COMMAND)(operate.lease)
app.command(rich_help_panel=COMMAND)(operate.io)
app.command(rich_help_panel=COMMAND)(operate.contact)
app.command("dry-run", rich_help_panel=COMMAND)(operate.dry_run)
app.add_typer(krc.krc, name="krc", rich_help_panel=REAL)
app.command(rich_help_panel=STUDY)(study.experiment)
app.add_typer(fault.fault, name="fault", rich_help_panel=STUDY)
app.command(rich_help_panel=STUDY)(fault.soak)
app.command(rich_help_panel=STUDY)(study.peg_and_valve)
app.command(rich_help_panel=STUDY)(study.bench)
app.command(rich_help_panel=STUDY)(recordings.replay)
app.command(rich_help_panel=STUDY)(recordings.plot)
app.command(rich_help_panel=STUDY)(recordings.report)
app.command(rich_help_panel=STUDY)(installation.check)
app.command(rich_help_panel=STUDY)(installation.schema)
app.command(rich_help_panel=STUDY)(installation.doctor)
