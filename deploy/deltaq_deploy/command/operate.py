"""Verbs that command a running cell."""

from __future__ import annotations

import contextlib
import math
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_controllers.camera import FOLLOWS
from deltaq_deploy.command.console import print_json, shown_compiled_ahead
from deltaq_deploy.command.options import (
    CellOption,
    ControllerOption,
    JsonOption,
    RobotOption,
    TokenOption,
    UrlOption,
)
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError

if TYPE_CHECKING:
    from deltaq_protocol.messages import LeaseStatus, ViewReply, ViewTarget, ViewWish


def stop(cell: CellOption = "lab", url: UrlOption = None, json: JsonOption = False) -> None:
    """Bring every robot of the cell to rest; each is held until it is reset. Anyone may."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.bring_to_rest import stop_over_a_line
    from deltaq_deploy.launch.cell_connection import Where, connect

    try:
        with connect(Where.of(cell, url), "deltaq stop") as running:
            done = running.stop()
    except ServiceUnreachableError as no_session:
        if url is not None:
            raise
        # every session may be taken; of lines there are some that are kept for a stop
        try:
            done = stop_over_a_line(load_cell(cell))
        except ServiceUnreachableError:
            raise no_session from None
    if json:
        print_json(done.model_dump(mode="json"))
    else:
        typer.echo("stopped: every robot brakes and is held; `deltaq reset` ends that")


def reset(
    robot: Annotated[str, typer.Option("--robot", help="Only this robot of the cell.")] = "",
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """End the hold of every robot of the cell, or of one; refused while its cause persists."""
    from deltaq_deploy.launch.cell_connection import Where, connect

    refused: list[RefusedError] = []
    with connect(Where.of(cell, url, robot), "deltaq reset", token) as running:
        done = {}
        for name in [robot] if robot else list(running.robots):
            try:
                done[name] = running.reset(name).model_dump(mode="json")
            except RefusedError as error:
                refused.append(error)
    if json and not refused:
        print_json(done[robot] if robot else {"robots": done})
    elif done and not json:
        typer.echo(f"reset: {', '.join(done)} {'is' if len(done) == 1 else 'are'} ready")
    if refused:
        for other in refused[1:]:
            typer.echo(f"deltaq: {other}", err=True)
        raise refused[0]


def lease(
    robot: RobotOption,
    cell: CellOption = "lab",
    url: UrlOption = None,
    take: Annotated[
        bool,
        typer.Option(
            "--take", help="Take it from its holder and keep it until Ctrl-C: no client can move the robot."
        ),
    ] = False,
    release: Annotated[
        bool,
        typer.Option("--release", help="Take it from its holder and release it: any client can acquire it."),
    ] = False,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Show who holds the lease of a robot, or take it away."""
    from deltaq_deploy.launch.cell_connection import Where, connect

    if take and release:
        raise typer.BadParameter("choose one of --take and --release")
    with connect(Where.of(cell, url, robot), "deltaq lease", token) as running:
        if release:
            with running.lease(robot, take=True):
                pass
        if not take:
            _show(robot, running.status().robots[robot].lease, json)
            return
        with running.lease(robot, take=True):
            _show(robot, running.status().robots[robot].lease, json)
            # the client renews it in a separate thread
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    time.sleep(60)


def _show(robot: str, held: LeaseStatus, json: bool) -> None:

    if json:
        print_json({"robot": robot} | held.model_dump(mode="json"))
    elif held.holder is None:
        typer.echo(f"{robot}: free")
    else:
        typer.echo(f"{robot}: leased by {held.holder} (lease {held.epoch})")


def io(
    robot: RobotOption,
    outputs: Annotated[
        list[str] | None, typer.Argument(metavar="OUTPUT=on|off", help="Outputs to set; none: show all.")
    ] = None,
    couple: Annotated[
        str | None, typer.Option("--couple", metavar="TOOL", help="Couple a tool at its tool changer.")
    ] = None,
    release: Annotated[bool, typer.Option("--release", help="Open its tool changer.")] = False,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Show outputs, inputs and tool of a robot, or switch them; refused while another client has its lease."""
    from deltaq_deploy.launch.cell_connection import Where, connect

    asked = dict(_switched(each) for each in outputs or ())
    if release and couple is not None:
        raise typer.BadParameter("choose one of --couple and --release")
    with connect(Where.of(cell, url, robot), "deltaq io", token) as running:
        if asked or release or couple is not None:
            with running.lease(robot) as leased:
                if asked:
                    leased.io(asked)
                if release or couple is not None:
                    leased.couple(couple)
        told, has = running.io(robot), running.description.coupled
    if json:
        print_json(told.model_dump(mode="json") | ({"tool": has[robot]} if robot in has else {}))
        return
    if robot in has:
        unknown = "not known; name it with --couple, or --release it"
        typer.echo(f"tool: {unknown if has[robot] is None else has[robot] or 'none'}")
    for kind, values in (("output", told.outputs), ("input", told.inputs)):
        for name, is_on in values.items():
            typer.echo(f"{kind} {name}: {'on' if is_on else 'off'}")
    if not told.outputs and not told.inputs:
        typer.echo(
            f"{robot} has no digital outputs or inputs; they are named under its driver in the cell's YAML"
        )


def _switched(text: str) -> tuple[str, bool]:
    name, _, value = text.partition("=")
    if not name or value not in ("on", "off"):
        raise typer.BadParameter(f"OUTPUT=on or OUTPUT=off, got {text!r}", param_hint="OUTPUT")
    return name, value == "on"


def contact(
    name: Annotated[str | None, typer.Argument(help="A contact of the cell; none: list them.")] = None,
    forbid: Annotated[bool, typer.Option("--forbid", help="Keep its bodies apart again.")] = False,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Allow a contact of the cell, at its own low speed, or list the contacts."""
    from deltaq_deploy.launch.cell_connection import connect, described

    description = described(cell, url, "deltaq contact")
    with connect(description, "deltaq contact", token) as running:
        done = running.allow_contact(name, not forbid) if name is not None else None
        allowed = running.status().contacts
    if json:
        told = {"contacts": {each: each in allowed for each in description.contacts}}
        print_json(done.model_dump(mode="json") if done else told)
    elif done is not None:
        typer.echo(done.what)
    else:
        for each, its in description.contacts.items():
            touching = f"{', '.join(its.bodies)} with {', '.join(its.against)}"
            typer.echo(f"{each}: {'allowed' if each in allowed else 'forbidden'} ({touching})")
        if not description.contacts:
            typer.echo(f"{description.cell} has no contacts; they are described under `contacts` in its YAML")


def dry_run(
    robot: RobotOption,
    dq: Annotated[
        str,
        typer.Option(metavar="DQ,DQ,...", help="Increment of one cycle, a number for each joint [rad or m]."),
    ],
    cell: CellOption = "lab",
    url: UrlOption = None,
    json: JsonOption = False,
) -> None:
    """Ask for the gate's verdict on an increment; nothing moves. Exit status 1 unless all of it would be admitted."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.cell_connection import Where, connect
    from deltaq_protocol.messages import Outcome

    try:
        increment = [float(number) for number in dq.split(",")]
    except ValueError:
        increment = []
    if not increment or not all(map(math.isfinite, increment)):
        raise typer.BadParameter(f"finite numbers with commas between them, got {dq!r}", param_hint="--dq")
    where = Where.of(cell, url, robot)
    with connect(where if url is not None else load_cell(cell), "deltaq dry-run") as running:
        verdict = running.dry_run(robot, increment)
    if json:
        print_json(verdict.model_dump(mode="json"))
    else:
        typer.echo(
            f"{verdict.outcome}, {verdict.scale:.0%} of it; it would stop within {verdict.time_to_stop_s:g} s"
        )
        for reason in verdict.reasons:
            typer.echo(
                f"  {reason.code}: {reason.what} {_number(reason.value)} (bound {_number(reason.bound)})"
            )
        if verdict.clearance_m is not None and verdict.pair is not None:
            typer.echo(f"  nearest: {' and '.join(verdict.pair)}, {verdict.clearance_m:.3f} m apart")
    if verdict.outcome is not Outcome.ADMITTED:
        raise typer.Exit(1)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


_CAMERA = typer.Option(help="Robot with the camera (default: the cell's first).", metavar="ROBOT")
_LEADER = typer.Option(help="Robot whose tool the camera looks at.", metavar="ROBOT")
_DISTANCE = typer.Option(min=0.2, max=4.0, help="Distance from the lens to the target.")
_OFFSET = typer.Option(help="Target in the frame of the leader's tool.")
_FOCUS = typer.Option(help="Fixed target, in the world frame.")
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
    controller: ControllerOption = FOLLOWS,
    duration_s: Annotated[
        float | None, typer.Option(min=0.1, help="Duration; until Ctrl-C if not given.")
    ] = None,
    cell: CellOption = "lab",
    url: UrlOption = None,
) -> None:
    """Follow a robot of a running cell with another robot's camera; `deltaq camera view` changes the view."""
    from deltaq_cell.load import parse_cell
    from deltaq_cell.roles import camera_roles
    from deltaq_deploy.launch.cell_connection import Where, connect
    from deltaq_deploy.launch.prepare import Needed

    where = Where.of(cell, url)
    with connect(where, "deltaq camera follow") as running:
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
    """Change the target of a robot's camera, while a controller follows."""
    targets = [_target(text) for text in target] if target else None
    if all(wish is None for wish in (distance_m, leader, aim_offset_m, focus_m, targets)):
        raise typer.BadParameter(
            "name what changes, e.g. --distance-m 0.9; `deltaq camera show` shows the view"
        )
    _tell_view(robot, cell, url, token, json, distance_m, leader, aim_offset_m, focus_m, targets)


def show_view(
    robot: Annotated[str | None, _CAMERA] = None,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Show the target of a robot's camera, and how well the camera sees it."""
    _tell_view(robot, cell, url, token, json)


def _tell_view(
    robot: str | None, cell: str, url: str | None, token: str | None, json: bool, *wishes: Any
) -> None:
    """Request a view if one is given, and print the present one."""
    from deltaq_cell.load import parse_cell
    from deltaq_cell.roles import first_camera
    from deltaq_deploy.launch.cell_connection import Where, connect

    with connect(Where.of(cell, url, robot or ""), "deltaq camera", token) as running:
        described = running.description
        robot = robot or first_camera(parse_cell(described.yaml, described.cell))
        told = running.view(robot, *wishes)
    if json:
        print_json(told.model_dump(mode="json"))
        return
    typer.echo(f"{robot}: {_wished(told.view)}; {_followed(told)}")


def _target(text: str) -> ViewTarget:
    """A target, from its form on the command line.

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
        raise typer.BadParameter(f"{text!r} is not a target like {example}", param_hint="--target") from None


def _point(text: str) -> list[float]:
    return [float(coordinate) for coordinate in text.split(",")]


def _wished(view: ViewWish) -> str:
    """The request."""
    wished = view.model_dump(exclude_none=True, exclude={"targets"})
    parts = [f"{name} {value}" for name, value in wished.items()]
    if view.targets is not None:
        parts.append(f"targets {' then '.join(target.words() for target in view.targets)}")
    return ", ".join(parts) or "as its follower was started"


def _followed(told: ViewReply) -> str:
    """The follower, its camera's target, and how well the camera sees it."""
    if not told.holder:
        return "no client drives the robot: the next follower uses this view"
    if told.target is None:
        return f"{told.holder} has the robot"
    sight = "" if told.sight is None else f", {told.sight}"
    return f"{told.holder} looks at {told.target.words()}{sight}"
