"""`deltaq stop`."""

from __future__ import annotations

import typer

from deltaq_deploy.cli.options import CellOption, JsonOption


def stop(cell: CellOption = "lab", json: JsonOption = False) -> None:
    """Bring every robot of the cell to rest; each is held until it is reset. Anyone may."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.cli.console import print_json
    from deltaq_deploy.running import connect

    with connect(load_cell(cell), "deltaq stop") as running:
        done = running.stop()
    if json:
        print_json(done.model_dump(mode="json"))
    else:
        typer.echo("stopped: every robot brakes and is held; `deltaq reset --robot NAME` ends that")
