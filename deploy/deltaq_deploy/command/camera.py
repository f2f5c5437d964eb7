"""Verbs for a robot with a camera: follow another robot, and change the view of whoever follows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_controllers.camera import FOLLOWS
from deltaq_deploy.command.options import CellOption, JsonOption, TokenOption, UrlOption

if TYPE_CHECKING:
    from deltaq_protocol.messages import ViewReply, ViewTarget, ViewWish

_CAMERA = typer.Option(help="Robot with the camera (default: the cell's first).", metavar="ROBOT")
_LEADER = typer.Option(help="Robot whose tool the camera looks at.", metavar="ROBOT")
_DISTANCE = typer.Option(min=0.2, max=4.0, help="Distance from the lens to the target.")
_OFFSET = typer.Option(help="Target in the frame of the leader's tool.")
_FOCUS = typer.Option(help="Target that stands still, in the world frame.")
_TARGET = typer.Option(
    "--target",
    metavar="ROBOT[:X,Y,Z]|X,Y,Z",
    help="A robot's tool, a point in its frame, or a point of the world, in m; repeatable, the most important first: "
    "the camera looks at the first that it can see.",
)
_Point = tuple[float, float, float]


def follow(
    robot: Annotated[str | None, _CAMERA] = None,
    leader: Annotated[str | None, _LEADER] = None,
    distance_m: Annotated[float, _DISTANCE] = 1.25,
    aim_offset_m: Annotated[_Point | None, _OFFSET] = None,
    focus_m: Annotated[_Point | None, _FOCUS] = None,
    controller: Annotated[
        str,
        typer.Option(
            help="paper, predictive, qp, clear-view, escape, or your own as package.module:function."
        ),
    ] = FOLLOWS,
    duration_s: Annotated[
        float | None, typer.Option(min=0.1, help="Duration; until Ctrl-C if not given.")
    ] = None,
    cell: CellOption = "lab",
    url: UrlOption = None,
) -> None:
    """Follow a robot of a running cell with another robot's camera; `deltaq view` changes the view meanwhile."""
    from deltaq_cell.load import parse_cell
    from deltaq_cell.roles import camera_roles
    from deltaq_deploy.command.progress import shown_compiled_ahead
    from deltaq_deploy.launch.cell_connection import Where, connect
    from deltaq_deploy.launch.prepare import Needed

    where = Where.of(cell, url)
    with connect(where, "deltaq follow") as running:
        roles = camera_roles(parse_cell(running.description.yaml, running.description.cell), robot, leader)
    words = ["--url", where.hli, "--robot", roles.follower, "--leader", roles.leader]
    words += ["--controller", controller, "--distance-m", f"{distance_m!r}"]
    for name, point in (("--aim-offset-m", aim_offset_m), ("--focus-m", focus_m)):
        words += [] if point is None else [name, *(f"{part!r}" for part in point)]
    words += [] if duration_s is None else ["--duration-s", f"{duration_s!r}"]
    with shown_compiled_ahead(Needed([controller])):
        # imported here, since these modules search for their machine code on import
        from deltaq_controllers.camera_follower import main
    raise typer.Exit(main(words))


def view(
    robot: Annotated[str | None, _CAMERA] = None,
    distance_m: Annotated[float | None, _DISTANCE] = None,
    leader: Annotated[str | None, _LEADER] = None,
    aim_offset_m: Annotated[_Point | None, _OFFSET] = None,
    focus_m: Annotated[_Point | None, _FOCUS] = None,
    target: Annotated[list[str] | None, _TARGET] = None,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Show what a robot's camera looks at, or change it while a controller follows."""
    from deltaq_cell.load import parse_cell
    from deltaq_cell.roles import first_camera
    from deltaq_deploy.command.console import print_json
    from deltaq_deploy.launch.cell_connection import Where, connect, known_robot

    targets = [_target(text) for text in target] if target else None
    with connect(Where.of(cell, url, robot or ""), "deltaq view", token) as running:
        described = running.description
        known_robot(described, robot or "")
        robot = robot or first_camera(parse_cell(described.yaml, described.cell))
        told = running.view(robot, distance_m, leader, aim_offset_m, focus_m, targets)
    if json:
        print_json(told.model_dump(mode="json"))
        return
    typer.echo(f"{robot}: {_wished(told.view)}; {_followed(told)}")


def _target(text: str) -> ViewTarget:
    """A target as it is written on the command line.

    Raises:
        typer.BadParameter: it is none.
    """
    from deltaq_protocol.codec import InvalidMessageError, from_map
    from deltaq_protocol.messages import ViewTarget

    robot, colon, offset = text.partition(":")
    try:
        if colon:
            fields: dict[str, object] = {"leader": robot, "aim_offset_m": _point(offset)}
        else:
            fields = {"focus_m": _point(text)} if "," in text else {"leader": text}
        return from_map(ViewTarget, fields)
    except InvalidMessageError as error:
        raise typer.BadParameter(f"{text!r}: {error}", param_hint="--target") from None
    except ValueError:
        example = "gr, gr:0,0,0.04 or -0.4,-0.7,1.3"
        raise typer.BadParameter(f"{text!r} is no target like {example}", param_hint="--target") from None


def _point(text: str) -> list[float]:
    return [float(coordinate) for coordinate in text.split(",")]


def _wished(view: ViewWish) -> str:
    """What was asked for."""
    wished = view.model_dump(exclude_none=True, exclude={"targets"})
    parts = [f"{name} {value}" for name, value in wished.items()]
    if view.targets is not None:
        parts.append(f"targets {' then '.join(target.words() for target in view.targets)}")
    return ", ".join(parts) or "as its follower was started"


def _followed(told: ViewReply) -> str:
    """Who follows, what the camera looks at now, and how well it sees it."""
    if not told.holder:
        return "nobody has the robot: the next who follows looks there"
    if told.target is None:
        return f"{told.holder} has the robot"
    sight = "" if told.sight is None else f", {told.sight}"
    return f"{told.holder} looks at {told.target.words()}{sight}"
