"""`deltaq record`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption


def record(
    file: Annotated[Path, typer.Argument(help="MCAP file to write; it must not exist.")],
    cell: CellOption = "lab",
    duration_s: Annotated[
        float | None, typer.Option(min=0.1, help="Duration of the recording; until Ctrl-C if not given.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Record a running cell: what controllers see, and every input and output of the gate."""
    import contextlib
    import signal

    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json, print_table
    from deltaq_command.progress import progress_bar
    from deltaq_services.process import end_on_interrupt
    from deltaq_services.recorder.shell import Recorder

    signal.signal(signal.SIGTERM, end_on_interrupt)
    interrupted = contextlib.suppress(KeyboardInterrupt)  # that is how a recording ends
    with Recorder(load_cell(cell), file) as recorder, progress_bar(f"recording to {file}"), interrupted:
        recorder.run(duration_s)
    writer = recorder.writer
    summary = {
        "file": str(file),
        "messages": writer.messages,
        "gate_messages": writer.gate_messages,
        "bytes": file.stat().st_size,
        "lost": recorder.lost,
        "invalid": recorder.invalid,
    }
    if json:
        print_json(summary)
    else:
        print_table("recorded", ("what", "value"), ((key, str(value)) for key, value in summary.items()))
