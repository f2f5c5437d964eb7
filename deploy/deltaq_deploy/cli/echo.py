"""`deltaq echo`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from deltaq_deploy.cli.options import CellOption


def echo(
    topic: Annotated[str, typer.Argument(help="state, verdict, increment or proximity.")],
    cell: CellOption = "lab",
    robot: Annotated[str, typer.Option(help="Only this robot.")] = "",
    count: Annotated[int, typer.Option(min=0, help="End after so many messages; 0: never.")] = 0,
) -> None:
    """Print messages as they come, one JSON object a line."""
    import zenoh

    from deltaq_cell.load import load_cell
    from deltaq_deploy.cli.console import print_json
    from deltaq_deploy.cli.topics import open_stream
    from deltaq_deploy.running import known_robot, listen
    from deltaq_protocol.codec import unpack

    row = open_stream(topic)
    description = load_cell(cell)
    known_robot(description, robot)
    printed = 0
    channel: Any = zenoh.handlers.FifoChannel(1024)
    with listen(description) as listener, listener.subscribe(row, channel, robot) as samples:
        try:
            for sample in samples:
                print_json(unpack(row.message, sample.payload.to_bytes()).model_dump(mode="json"))
                printed += 1
                if printed == count:
                    return
        except KeyboardInterrupt:
            return
