"""`deltaq echo`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from deltaq_command.options import CellOption, UrlOption


def echo(
    topic: Annotated[str, typer.Argument(help="state, verdict or proximity.")],
    cell: CellOption = "lab",
    url: UrlOption = None,
    robot: Annotated[str, typer.Option(help="Only this robot.")] = "",
    count: Annotated[int, typer.Option(min=0, help="End after this many messages; 0: never.")] = 0,
) -> None:
    """Print messages as they come, one JSON object a line."""
    import zenoh

    from deltaq_command.console import print_json
    from deltaq_command.topics import open_stream
    from deltaq_launch.cell_connection import Where, describe, known_robot, listen
    from deltaq_protocol.codec import unpack

    row = open_stream(topic)
    where = Where.of(cell, url, robot)
    known_robot(describe(where, "deltaq echo"), robot)
    printed = 0
    channel: Any = zenoh.handlers.FifoChannel(1024)
    with listen(where) as listener, listener.subscribe(row, channel, robot) as samples:
        try:
            for sample in samples:
                print_json(unpack(row.message, sample.payload.to_bytes()).model_dump(mode="json"))
                printed += 1
                if printed == count:
                    return
        except KeyboardInterrupt:
            return
