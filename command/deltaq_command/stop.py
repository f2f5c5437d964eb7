"""`deltaq stop`."""

from __future__ import annotations

import typer

from deltaq_command.options import CellOption, JsonOption, UrlOption


def stop(cell: CellOption = "lab", url: UrlOption = None, json: JsonOption = False) -> None:
    """Bring every robot of the cell to rest; each is held until it is reset. Anyone may."""
    from deltaq_command.console import print_json
    from deltaq_launch.cell_connection import Where, connect

    with connect(Where.of(cell, url), "deltaq stop") as running:
        done = running.stop()
    if json:
        print_json(done.model_dump(mode="json"))
    else:
        typer.echo("stopped: every robot brakes and is held; `deltaq reset --robot NAME` ends that")
