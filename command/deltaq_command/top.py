"""`deltaq top`."""

from __future__ import annotations

import contextlib
from itertools import count as counted
from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption, UrlOption


def top(
    cell: CellOption = "lab",
    url: UrlOption = None,
    interval_s: Annotated[float, typer.Option(min=0.05, help="Time between two updates.")] = 0.5,
    count: Annotated[int, typer.Option(min=0, help="End after this many updates; 0: at Ctrl-C.")] = 0,
    json: JsonOption = False,
) -> None:
    """Watch a running cell: repeat `status` until Ctrl-C; with --json one object a line."""
    import time

    from rich.live import Live

    from deltaq_command.console import console, print_json
    from deltaq_command.status import shown
    from deltaq_launch.cell_connection import Where, connect

    with connect(Where.of(cell, url), "deltaq top") as running, contextlib.suppress(KeyboardInterrupt):
        screen = contextlib.nullcontext() if json else Live(console=console(), auto_refresh=False)
        with screen as live:
            for look in counted(1):
                answer = running.status()
                if live is None:
                    print_json(answer.model_dump(mode="json"))
                else:
                    live.update(shown(answer, running.description), refresh=True)
                if look == count:
                    return
                time.sleep(interval_s)
