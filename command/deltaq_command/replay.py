"""`deltaq replay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_command.errors import BAD
from deltaq_command.options import JsonOption

if TYPE_CHECKING:
    from deltaq_verification.replay import Replay


def replay(
    file: Annotated[Path, typer.Argument(help="MCAP file that deltaq recorded.")], json: JsonOption = False
) -> None:
    """Run a recording through the gate again and compare every verdict; exit status 1 if anything differs."""
    from deltaq_command.console import print_json, print_table
    from deltaq_command.progress import progress_bar
    from deltaq_verification.replay import replay as run

    with progress_bar(f"replaying {file}") as progress:
        result = run(file, progress)
    summary = summarise(result)
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


def summarise(result: Replay) -> dict[str, Any]:
    """The result as JSON prints it."""
    return {
        "good": result.good,
        "messages": result.messages,
        "verdicts": result.verdicts,
        "admissions": result.admissions,
        "receipts": result.receipts,
        "memories": result.memories,
        "differences": [difference.__dict__ for difference in result.differences],
        "difference_count": result.difference_count,
        "broken_receipts": result.broken_receipts,
        "gaps": result.gaps,
        "skipped": result.skipped,
        "verdicts_sha256": result.verdicts_sha256,
        "recorded_sha256": result.recorded_sha256,
        "fingerprint": result.fingerprint,
        "recorded_fingerprint": result.recorded_fingerprint,
        "notices": result.notices,
    }


def notices(result: Replay) -> list[str]:
    """Notices that a reader of the figures needs."""
    lines = [*result.notices, *result.gaps]
    if result.skipped:
        lines.append(
            f"{result.skipped} messages of the gate lie before a snapshot of it and were not replayed"
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
    return lines
