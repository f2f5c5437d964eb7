"""Verbs that write, replay, draw and report recordings."""

from __future__ import annotations

import contextlib
import signal
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.console import print_json, print_table, progress_bar
from deltaq_deploy.command.options import CellOption, JsonOption
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from deltaq_testing.replay import Replay


def record(
    output: Annotated[Path, typer.Option(metavar="FILE", help="MCAP file to write; it must not exist.")],
    cell: CellOption = "lab",
    duration_s: Annotated[
        float | None, typer.Option(min=0.1, help="Duration of the recording; until Ctrl-C if not given.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Record a running cell: states and verdicts, and every input and output of the gate."""
    from deltaq_cell.load import load_cell
    from deltaq_services.process import end_on_interrupt
    from deltaq_services.recorder.shell import Recorder

    signal.signal(signal.SIGTERM, end_on_interrupt)
    interrupted = contextlib.suppress(KeyboardInterrupt)  # that is how a recording ends
    with Recorder(load_cell(cell), output) as recorder, progress_bar(f"recording to {output}"), interrupted:
        recorder.run(duration_s)
    writer = recorder.writer
    summary = {
        "file": str(output),
        "messages": writer.messages,
        "gate_messages": writer.gate_messages,
        "bytes": output.stat().st_size,
        "lost": recorder.lost,
        "invalid": recorder.invalid,
    }
    if json:
        print_json(summary)
    else:
        print_table("recorded", ("what", "value"), ((key, str(value)) for key, value in summary.items()))


def replay(
    file: Annotated[Path, typer.Argument(help="MCAP file that deltaq recorded.")], json: JsonOption = False
) -> None:
    """Run a recording through the gate again and compare every verdict; exit status 1 if any differs or is missing."""
    from deltaq_testing.replay import replay as run

    with progress_bar(f"replaying {file}") as progress:
        result = run(file, progress)
    summary = {"good": result.good, **asdict(result)}
    if json:
        print_json(summary)
    else:
        shown = {key: value for key, value in summary.items() if not isinstance(value, list)}
        print_table("replayed", ("what", "value"), ((key, str(value)) for key, value in shown.items()))
        for difference in result.differences:
            typer.echo(f"differs: {difference}")
        if result.difference_count > len(result.differences):
            typer.echo(f"and {result.difference_count - len(result.differences)} more differences")
        for line in result.broken_receipts:
            typer.echo(f"broken chain: {line}")
    for line in notices(result):
        typer.echo(f"deltaq: {line}", err=True)
    if not result.good:
        raise typer.Exit(BAD)


def notices(result: Replay) -> list[str]:
    """Notices that a reader of the figures needs."""
    lines = [*result.notices, *result.gaps]
    if result.skipped:
        lines.append(
            f"messages of the gate that precede its first snapshot, and were not replayed: {result.skipped}"
        )
    code, _, configuration = result.fingerprint.partition("-")
    recorded_code, _, recorded_configuration = result.recorded_fingerprint.partition("-")
    if recorded_code and code != recorded_code:
        lines.append(f"recorded by other gate code ({recorded_code}) than replayed it ({code})")
    if recorded_configuration and configuration != recorded_configuration:
        lines.append(
            f"recorded with another configuration ({recorded_configuration}) than replayed ({configuration})"
        )
    if not result.messages:
        lines.append("nothing could be replayed: the recording has no snapshot of the gate to begin from")
    elif not result.verdicts:
        lines.append(
            "nothing to compare: no verdict of the gate was recorded, since no controller asked for motion"
        )
    return lines


def plot(
    file: Annotated[Path, typer.Argument(help="MCAP file that deltaq recorded.")],
    output: Annotated[
        Path | None, typer.Option(help="Picture to write; beside the recording if not given.")
    ] = None,
) -> None:
    """Draw a recording: the paths of the tools, or the paper's figure if the camera on fr follows gr."""
    from deltaq_experiments.tracking import plot as draw

    picture = output or file.with_suffix(".png")
    with progress_bar(f"drawing {file}"):
        notices = draw(file, picture)
    for line in notices:
        typer.echo(f"deltaq: {line}", err=True)
    typer.echo(f"{picture}")


def report(
    file: Annotated[Path, typer.Argument(help="MCAP file that deltaq recorded.")],
    output: Annotated[
        Path | None, typer.Option(help="HTML page to write; beside the recording if not given.")
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print the figures as JSON, and write a page only for --output.")
    ] = False,
) -> None:
    """Report a recording on one HTML page: verdicts, stops and faults over time, clearance, joints and limits."""
    from deltaq_experiments.run_report.figures import figures
    from deltaq_experiments.run_report.page import must_be_free, page, write
    from deltaq_experiments.run_report.run import read_run

    place = output or (None if json else file.with_suffix(".html"))
    if place is not None:
        must_be_free(place)
    with progress_bar(f"reading {file}") as progress:
        run = read_run(file, progress)
        if place is not None:
            write(place, page(run))
    for line in run.notices:
        typer.echo(f"deltaq: {line}", err=True)
    if json:
        print_json({**figures(run), "page": place and str(place)})
    else:
        typer.echo(f"{place}")
