"""`deltaq lease`."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_command.options import CellOption, JsonOption, RobotOption, TokenOption, UrlOption

if TYPE_CHECKING:
    from deltaq_protocol.messages import LeaseStatus


def lease(
    robot: RobotOption,
    cell: CellOption = "lab",
    url: UrlOption = None,
    take: Annotated[
        bool,
        typer.Option("--take", help="Take it from its holder and keep it until Ctrl-C: nobody can move."),
    ] = False,
    release: Annotated[
        bool,
        typer.Option("--release", help="Take it from its holder and release it: anybody can acquire it."),
    ] = False,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Show who holds the lease of a robot, or take it away."""
    import time

    from deltaq_launch.cell_connection import Where, connect, known_robot

    if take and release:
        raise typer.BadParameter("choose one of --take and --release")
    with connect(Where.of(cell, url, robot), "deltaq lease", token) as running:
        known_robot(running.description, robot)
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
    from deltaq_command.console import print_json

    if json:
        print_json({"robot": robot} | held.model_dump(mode="json"))
    elif held.holder is None:
        typer.echo(f"{robot}: free")
    else:
        typer.echo(f"{robot}: leased by {held.holder} (lease {held.epoch})")
