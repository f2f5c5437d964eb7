"""`deltaq plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def plot(
    file: Annotated[Path, typer.Argument(help="MCAP file that deltaq recorded.")],
    figure: Annotated[
        Path | None, typer.Option(help="Picture to write; beside the recording if not given.")
    ] = None,
) -> None:
    """Draw a recording: where the tools went; of a camera on fr that follows gr, the paper's figure."""
    from deltaq_command.progress import progress_bar
    from deltaq_experiments.replay_plot import plot as draw

    picture = figure or file.with_suffix(".png")
    with progress_bar(f"drawing {file}"):
        notices = draw(file, picture)
    for line in notices:
        typer.echo(f"deltaq: {line}", err=True)
    typer.echo(f"{picture}")
