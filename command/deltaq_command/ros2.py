"""`deltaq ros2`."""

from __future__ import annotations

from typing import Annotated

import typer

from deltaq_command.options import CellOption, JsonOption, UrlOption


def ros2(
    cell: CellOption = "lab",
    url: UrlOption = None,
    ros_endpoint: Annotated[
        str,
        typer.Option(
            metavar="tcp/HOST:PORT",
            help="Address of the zenoh router of ROS (rmw_zenohd). Its own default port, 7447, is that of the HLI "
            "in the shipped cells.",
        ),
    ] = "tcp/127.0.0.1:7448",
    domain_id: Annotated[
        int, typer.Option(min=0, max=232, envvar="ROS_DOMAIN_ID", help="ROS domain, 0 to 232.")
    ] = 0,
    namespace: Annotated[
        str | None,
        typer.Option(help="Namespace of node and topics, e.g. /plant/lab.", show_default="the cell's name"),
    ] = None,
    accept_trajectories: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROBOT",
            help="A robot that JointTrajectory messages may move, by its lease and through the gate; repeatable. "
            "Without it the bridge only publishes.",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Publish joint states of a running cell to ROS 2 over zenoh, and follow joint trajectories, until Ctrl-C.

    Units are rad and m, rad/s and m/s. It speaks as rmw_zenoh does, and needs no ROS itself. With --json each line is
    an object, and the last one has the counts.
    """
    import asyncio
    import os

    from deltaq_controllers.live import until_told
    from deltaq_controllers.ros2.bridge import Bridge, RosSide
    from deltaq_launch.cell_connection import Where
    from deltaq_protocol import log

    if json:
        os.environ[log.FORMAT] = log.LogFormat.JSON
    log.configure("ros2")
    side = RosSide(ros_endpoint, domain_id, namespace, tuple(dict.fromkeys(accept_trajectories or ())))
    bridge = Bridge(Where.of(cell, url).hli, side)
    asyncio.run(until_told(bridge.run()))
    log.say_result(bridge.summary())
