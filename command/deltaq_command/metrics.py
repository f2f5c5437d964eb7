"""`deltaq metrics`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.options import CellOption, UrlOption


def metrics(
    cell: CellOption = "lab",
    url: UrlOption = None,
    address: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0: any free port.")] = 9464,
) -> None:
    """Serve the metrics of a running cell for Prometheus, until Ctrl-C; the cell may come and go meanwhile."""
    import asyncio
    import contextlib

    from deltaq_launch.cell_connection import Where
    from deltaq_protocol.errors import ServiceUnreachableError
    from deltaq_protocol.log import configure
    from deltaq_services.metrics.shell import Exporter

    configure("metrics")
    exporter = Exporter(Where.of(cell, url).hli)
    with contextlib.suppress(KeyboardInterrupt):
        try:
            asyncio.run(exporter.run(address, port))
        except OSError as error:
            raise ServiceUnreachableError(f"cannot listen on {address}:{port}: {error.strerror}") from None
