"""`deltaq reset`."""

from __future__ import annotations

import typer

from deltaq_deploy.cli.options import CellOption, JsonOption, RobotOption, TokenOption


def reset(
    robot: RobotOption, cell: CellOption = "lab", token: TokenOption = None, json: JsonOption = False
) -> None:
    """Let a robot that is held move again; refused while the cause stands."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.cli.console import print_json
    from deltaq_deploy.running import connect, known_robot

    description = load_cell(cell)
    known_robot(description, robot)
    with connect(description, "deltaq reset", token) as running:
        done = running.reset(robot)
    if json:
        print_json(done.model_dump(mode="json"))
    else:
        typer.echo(f"reset: {robot} is ready")
