"""Verbs for a robot with a camera: follow another robot, and change the view of whoever follows."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption, TokenOption, UrlOption

_CAMERA = typer.Option(help="Robot with the camera (default: the cell's first).", metavar="ROBOT")
_LEADER = typer.Option(help="Robot whose tool the camera looks at.", metavar="ROBOT")
_DISTANCE = typer.Option(min=0.2, max=4.0, help="Distance from the lens to the target.")
_OFFSET = typer.Option(help="Target in the frame of the leader's tool.")
_FOCUS = typer.Option(help="Target that stands still, in the world frame.")
_Point = tuple[float, float, float]


def follow(
    robot: Annotated[str | None, _CAMERA] = None,
    leader: Annotated[str | None, _LEADER] = None,
    distance_m: Annotated[float, _DISTANCE] = 1.25,
    aim_offset_m: Annotated[_Point | None, _OFFSET] = None,
    focus_m: Annotated[_Point | None, _FOCUS] = None,
    controller: Annotated[
        str, typer.Option(help="paper, predictive, qp, escape, or your own as package.module:function.")
    ] = "paper",
    duration_s: Annotated[
        float | None, typer.Option(min=0.1, help="Duration; until Ctrl-C if not given.")
    ] = None,
    cell: CellOption = "lab",
    url: UrlOption = None,
) -> None:
    """Follow a robot of a running cell with another robot's camera; `deltaq view` changes the view meanwhile."""
    from deltaq_cell.load import parse_cell
    from deltaq_cell.roles import camera_roles
    from deltaq_command.progress import shown_compiled_ahead
    from deltaq_launch.cell_connection import Where, connect

    where = Where.of(cell, url)
    with connect(where, "deltaq follow") as running:
        roles = camera_roles(parse_cell(running.description.yaml, running.description.cell), robot, leader)
    words = ["--url", where.hli, "--robot", roles.follower, "--leader", roles.leader]
    words += ["--controller", controller, "--distance-m", f"{distance_m!r}"]
    for name, point in (("--aim-offset-m", aim_offset_m), ("--focus-m", focus_m)):
        words += [] if point is None else [name, *(f"{part!r}" for part in point)]
    words += [] if duration_s is None else ["--duration-s", f"{duration_s!r}"]
    with shown_compiled_ahead([controller]):
        # imported here, since these modules search for their machine code on import
        from deltaq_controllers.camera_follower import main
    raise typer.Exit(main(words))


def view(
    robot: Annotated[str | None, _CAMERA] = None,
    distance_m: Annotated[float | None, _DISTANCE] = None,
    leader: Annotated[str | None, _LEADER] = None,
    aim_offset_m: Annotated[_Point | None, _OFFSET] = None,
    focus_m: Annotated[_Point | None, _FOCUS] = None,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Show what a robot's camera looks at, or change it while a controller follows."""
    from deltaq_cell.load import parse_cell
    from deltaq_cell.roles import first_camera
    from deltaq_command.console import print_json
    from deltaq_launch.cell_connection import Where, connect, known_robot

    with connect(Where.of(cell, url, robot or ""), "deltaq view", token) as running:
        described = running.description
        known_robot(described, robot or "")
        robot = robot or first_camera(parse_cell(described.yaml, described.cell))
        told = running.view(robot, distance_m, leader, aim_offset_m, focus_m)
    if json:
        print_json(told.model_dump(mode="json"))
        return
    wished = told.view.model_dump(exclude_none=True)
    text = ", ".join(f"{name} {value}" for name, value in wished.items()) or "as its follower was started"
    by = (
        f"{told.holder} has the robot"
        if told.holder
        else "nobody has the robot: the next who follows looks there"
    )
    typer.echo(f"{robot}: {text}; {by}")
