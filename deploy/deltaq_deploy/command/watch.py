"""Verbs that look at a running cell."""

from __future__ import annotations

import contextlib
import os
import time
from itertools import count as counted
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.console import (
    PIPE_WIDTH,
    console,
    counts,
    degrees_or_millimetres,
    print_json,
    print_table,
    table_of,
)
from deltaq_deploy.command.options import CellOption, JsonOption, UrlOption
from deltaq_deploy.launch import BAD
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Group

    from deltaq_protocol.audit import AuditEntry
    from deltaq_protocol.blocking import BlockingCell
    from deltaq_protocol.messages import Description, Status


# `deltaq metrics`.


def metrics(
    cell: CellOption = "lab",
    url: UrlOption = None,
    address: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0: any free port.")] = 9464,
) -> None:
    """Serve the metrics of a running cell for Prometheus, until Ctrl-C; the cell may come and go meanwhile."""
    import asyncio

    from deltaq_deploy.launch.cell_connection import Where
    from deltaq_protocol.log import configure
    from deltaq_services.metrics.shell import Exporter

    configure("metrics")
    exporter = Exporter(Where.of(cell, url).hli)
    with contextlib.suppress(KeyboardInterrupt):
        try:
            asyncio.run(exporter.run(address, port))
        except OSError as error:
            raise ServiceUnreachableError(f"cannot listen on {address}:{port}: {error.strerror}") from None


# `deltaq ros2`.


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

    from deltaq_controllers.live import until_told
    from deltaq_controllers.ros2.bridge import Bridge, RosSide
    from deltaq_deploy.launch.cell_connection import Where
    from deltaq_protocol import log

    if json:
        os.environ[log.FORMAT] = log.LogFormat.JSON
    log.configure("ros2")
    side = RosSide(ros_endpoint, domain_id, namespace, tuple(dict.fromkeys(accept_trajectories or ())))
    bridge = Bridge(Where.of(cell, url).hli, side)
    asyncio.run(until_told(bridge.run()))
    log.say_result(bridge.summary())


def status(
    cell: CellOption = "lab",
    url: UrlOption = None,
    watch: Annotated[bool, typer.Option("--watch", help="Repeat it until Ctrl-C.")] = False,
    interval_s: Annotated[
        float, typer.Option(min=0.05, help="With --watch: time between two updates.")
    ] = 0.5,
    count: Annotated[
        int, typer.Option(min=0, help="With --watch: end after this many updates; 0: never.")
    ] = 0,
    service: Annotated[
        str | None,
        typer.Option(
            metavar="SERVICE",
            help="Ask this service, e.g. sim or robot-server-fr, whether it is healthy: exit status 0 yes, 1 no, "
            "3 no answer.",
        ),
    ] = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Also print the counters of all services, and the drives' lag.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Show a running cell: phases, leases, age of data, lagging services, the nearest pair.

    With --watch and --json it prints one object a line.
    """
    from deltaq_deploy.launch.cell_connection import Where, connect

    if service is not None:
        if watch or url is not None:
            raise typer.BadParameter("--service takes --cell, and neither --url nor --watch")
        _health(service, cell, json)
        return
    with connect(Where.of(cell, url), "deltaq status") as running:
        if watch:
            _watch(running, interval_s, count, verbose, json)
            return
        answer, description = running.status(), running.description
    if json:
        print_json(answer.model_dump(mode="json"))
    else:
        target = console()
        if not target.is_terminal:
            target.width = PIPE_WIDTH
        target.print(shown(answer, description, verbose))


def _watch(running: BlockingCell, interval_s: float, count: int, verbose: bool, json: bool) -> None:
    """Show the status of a cell again and again, until Ctrl-C or as often as is asked."""
    from rich.live import Live

    screen = contextlib.nullcontext() if json else Live(console=console(), auto_refresh=False)
    with contextlib.suppress(KeyboardInterrupt), screen as live:
        for look in counted(1):
            answer = running.status()
            if live is None:
                print_json(answer.model_dump(mode="json"))
            else:
                live.update(shown(answer, running.description, verbose), refresh=True)
            if look == count:
                return
            time.sleep(interval_s)


def _health(service: str, cell: str, json: bool) -> None:
    """Ask one service whether it is healthy.

    Raises:
        typer.Exit: it is not.
    """
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.probes import probe
    from deltaq_deploy.launch.services import cell_services, console_service, one, video_services

    description = load_cell(cell)
    others = (console_service(description, cell, ()), *video_services(description, cell))
    services = (*cell_services(description, cell), *others)
    answer = probe(one(services, service), description)
    if json:
        print_json({"service": service, "healthy": answer.healthy, "detail": answer.detail})
    else:
        typer.echo(f"{service}: {'healthy' if answer.healthy else 'not healthy'}  {answer.detail}".rstrip())
    if not answer.healthy:
        raise typer.Exit(BAD)


def shown(answer: Status, cell: Description, verbose: bool) -> Group:
    """Print a status as text; `verbose` adds counters and the drives' lag."""
    from rich.console import Group
    from rich.text import Text

    rows = []
    for name, robot in answer.robots.items():
        units = cell.robots[name].units if name in cell.robots else ()
        q = " ".join(degrees_or_millimetres(*joint) for joint in zip(robot.q, units, strict=False))
        age = None if robot.state_age_s is None else f"{robot.state_age_s * 1000:.0f} ms"
        rows.append((name, robot.phase, robot.reason, robot.cycle, age, robot.lease.holder, q))
    columns = ("robot", "phase", "reason", "cycle", "age", "leased by", "joints")
    lines = ["the gate is silent"] if answer.gate_age_s is None else []
    if verbose:
        lines += [f"gate: {counts(answer.gate)}", f"hli: {counts(answer.hli)}"]
    for name, robot in answer.robots.items() if verbose else ():
        lines.append(f"{name}: {counts(robot.counters)}")
        if robot.lag_s:
            lags = ("-" if lag_s is None else f"{lag_s * 1e3:.0f}" for lag_s in robot.lag_s)
            lines.append(f"{name}: lag of the drives, by axis: {' '.join(lags)} ms")
    if answer.contacts:
        lines.append(f"contacts allowed: {', '.join(answer.contacts)}")
    lines += [f"another cell: {said}" for said in answer.mismatches]
    lines += [f"lagging: {fault}" for fault in answer.lagging]
    if answer.nearest is not None:
        pair = " and ".join(answer.nearest.pair)
        lines.append(f"nearest: {pair}, {answer.nearest.distance_m * 1000:.0f} mm")
    return Group(table_of(f"cell {answer.identity or answer.cell}", columns, rows), *map(Text, lines))


_COLUMNS = (
    "time (UTC)",
    "count",
    "what",
    "outcome",
    "robot",
    "client",
    "identity",
    "address",
    "role",
    "told",
)


def audit(
    file: Annotated[
        Path | None, typer.Argument(help="File of the audit log; by default that of `deltaq up`.")
    ] = None,
    cell: CellOption = "lab",
    lines: Annotated[int, typer.Option(min=1, help="Number of entries to show, the newest ones.")] = 40,
    robot: Annotated[str | None, typer.Option(help="Only entries of this robot.")] = None,
    client: Annotated[
        str | None, typer.Option(help="Only entries of clients with this name, claimed or proved.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Show the audit log: leases, stops, resets, outputs, contacts and refused attempts, by client."""
    from deltaq_cell.load import load_cell
    from deltaq_services.hli.audit import default_audit_file, older

    path = file or default_audit_file(load_cell(cell).cell)
    if not path.exists():
        raise DeltaqError(f"there is no audit log {path}; `deltaq up` says where it writes one")
    torn = [0]
    newest_first = (
        entry
        for part in (path, *older(path))
        for entry in reversed(list(_entries(part, torn)))
        if robot in (None, entry.robot) and client in (None, entry.client, entry.identity)
    )
    shown = list(islice(newest_first, lines))[::-1]
    if json:
        for entry in shown:
            typer.echo(entry.model_dump_json())
    else:
        print_table(f"audit log {path}", _COLUMNS, map(_row, shown))
    if torn[0]:
        console_of_errors = console(typer.get_text_stream("stderr"))
        console_of_errors.print(
            f"invalid lines: {torn[0]}; a crash cut them short, or another version wrote them"
        )


def _entries(path: Path, torn: list[int]) -> Iterator[AuditEntry]:
    """The entries of one file, oldest first; `torn` counts lines that are not entries."""
    from pydantic import ValidationError

    from deltaq_protocol.audit import AuditEntry

    if not path.exists():
        return
    with path.open("rb") as opened:
        for line in opened:
            try:
                yield AuditEntry.model_validate_json(line)
            except ValidationError:
                torn[0] += 1


def _row(entry: AuditEntry) -> tuple[object, ...]:
    told = f"{entry.code}: {entry.text}" if entry.code else entry.text
    return (
        entry.time_utc.removesuffix("+00:00"), entry.count, entry.what, entry.outcome, entry.robot,
        entry.client, entry.identity, entry.address, entry.role, told,
    )  # fmt: skip
