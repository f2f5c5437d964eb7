"""`deltaq reset`."""

from __future__ import annotations

import typer

from deltaq_command.options import CellOption, JsonOption, RobotOption, TokenOption, UrlOption


def reset(
    robot: RobotOption,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """End the hold of a robot; refused while its cause persists."""
    from deltaq_command.console import print_json
    from deltaq_launch.cell_connection import Where, connect, known_robot

    with connect(Where.of(cell, url, robot), "deltaq reset", token) as running:
        known_robot(running.description, robot)
        done = running.reset(robot)
    if json:
        print_json(done.model_dump(mode="json"))
    else:
        typer.echo(f"reset: {robot} is ready")
