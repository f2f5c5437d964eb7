"""The command and its verbs.

A verb's file imports heavy packages (pinocchio, zenoh, matplotlib) inside its function, so that help and
completion are quick.
"""

from __future__ import annotations

import typer

from deltaq_command import (
    advise,
    bench,
    check,
    contact,
    demo,
    doctor,
    drive,
    dry_run,
    echo,
    experiment,
    fault,
    health,
    hz,
    key,
    krc,
    lease,
    peg_and_valve,
    plot,
    record,
    replay,
    reset,
    rsi,
    schema,
    status,
    stop,
    top,
    up,
)

RUN = "Run a cell"
WATCH = "Look at a running cell"
COMMAND = "Command a running cell"
STUDY = "Study and check"
REAL = "Real robots"

app = typer.Typer(
    help="A networked control server for industrial manipulators: any controller, one safety gate.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command(rich_help_panel=RUN)(up.up)
app.command(rich_help_panel=RUN)(demo.demo)
app.command(rich_help_panel=RUN)(key.key)
app.command(rich_help_panel=WATCH)(status.status)
app.command(rich_help_panel=WATCH)(top.top)
app.command(rich_help_panel=WATCH)(echo.echo)
app.command(rich_help_panel=WATCH)(hz.hz)
app.command(rich_help_panel=WATCH)(health.health)
app.command(rich_help_panel=WATCH)(record.record)
app.command(rich_help_panel=COMMAND)(drive.drive)
app.command(rich_help_panel=COMMAND)(advise.advise)
app.command(rich_help_panel=COMMAND)(stop.stop)
app.command(rich_help_panel=COMMAND)(reset.reset)
app.command(rich_help_panel=COMMAND)(lease.lease)
app.command(rich_help_panel=COMMAND)(contact.contact)
app.command("dry-run", rich_help_panel=COMMAND)(dry_run.dry_run)
app.command(rich_help_panel=REAL)(krc.krc)
app.add_typer(rsi.rsi, name="rsi", rich_help_panel=REAL)
app.command(rich_help_panel=STUDY)(experiment.experiment)
app.add_typer(fault.fault, name="fault", rich_help_panel=STUDY)
app.command(rich_help_panel=STUDY)(peg_and_valve.peg_and_valve)
app.command(rich_help_panel=STUDY)(bench.bench)
app.command(rich_help_panel=STUDY)(replay.replay)
app.command(rich_help_panel=STUDY)(plot.plot)
app.command(rich_help_panel=STUDY)(check.check)
app.command(rich_help_panel=STUDY)(schema.schema)
app.command(rich_help_panel=STUDY)(doctor.doctor)
