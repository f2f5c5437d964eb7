"""`deltaq up`."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.console import console, json_log, prefixed_log, shown_compiled_ahead
from deltaq_deploy.command.options import CellOption, ConsoleOption
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from deltaq_cell.description import CellDescription
    from deltaq_deploy.launch.launcher import Launcher
    from deltaq_deploy.launch.services import Service


def up(
    cell: CellOption = "lab",
    only: Annotated[str, typer.Option(help="Only these services or kinds, e.g. hli,sim,robot-server.")] = "",
    real: Annotated[bool, typer.Option("--real", help="Real robots: start no emulator.")] = False,
    record: Annotated[str, typer.Option(metavar="FILE", help="Also record to this MCAP file.")] = "",
    with_console: ConsoleOption = True,
    recordings: Annotated[
        str, typer.Option(metavar="FOLDER", help="Let the console write and open recordings in this folder.")
    ] = "",
    audit: Annotated[
        str,
        typer.Option(
            metavar="FILE",
            envvar="DELTAQ_AUDIT_FILE",
            help="Append the audit log to this file; by default one in the user's state folder.",
        ),
    ] = "",
    no_audit: Annotated[bool, typer.Option("--no-audit", help="Write no audit log.")] = False,
    log_format: Annotated[
        str,
        typer.Option(
            metavar="text|json",
            envvar="DELTAQ_LOG_FORMAT",
            help="How services log: lines to read, or one JSON object a line.",
        ),
    ] = "text",
) -> None:
    """Start the services of a cell on this machine, one process each; Ctrl-C brings the robots to rest."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.bring_to_rest import bring_to_rest
    from deltaq_deploy.launch.launcher import Launcher
    from deltaq_deploy.launch.prepare import needed_by
    from deltaq_protocol.log import FORMAT, LogFormat, log_format_named
    from deltaq_services.process import AUDIT_FILE

    chosen = log_format_named(log_format)
    os.environ[FORMAT] = chosen  # the services inherit it
    description = load_cell(cell)
    audit_file, why_none = (None, "") if no_audit else audit_file_of(audit, description.cell)
    os.environ.pop(AUDIT_FILE, None)  # the HLI gets it by its arguments, or not at all
    wanted = [name.strip() for name in only.split(",")] if only else []
    services = _services(
        description, cell, real, str(audit_file or ""), record, recordings, with_console, wanted
    )
    _refuse_unsafe(description, cell, services, real)
    names = [service.name for service in services]
    log = json_log(services) if chosen is LogFormat.JSON else prefixed_log(console(), names)
    launcher = Launcher(services, log, partial(bring_to_rest, description, "deltaq up"))
    with shown_compiled_ahead(needed_by(services, description, cell)), launcher:
        log("deltaq", f"starting {len(services)} services")
        launcher.start()
        log("deltaq", f"cell {description.cell} is up: {', '.join(service.name for service in services)}")
        if "hli" in launcher.ready:
            lines = f"{description.tcp_address}:{description.tcp_port}"
            log("deltaq", f"zenoh clients at {description.hli}, JSON lines at {lines}; Ctrl-C ends it")
            if audit_file is not None:
                log("deltaq", f"the audit log is {audit_file}; `deltaq audit` shows it")
            elif why_none:
                log("deltaq", f"no audit log: {why_none}")
        tell_of_console(launcher, with_console)
        ended = watch(launcher, cell)
    if ended or launcher.unrested:
        raise typer.Exit(BAD)


def _services(
    description: CellDescription,
    cell: str,
    real: bool,
    audit: str,
    record: str,
    recordings: str,
    with_console: bool,
    only: Sequence[str],
) -> tuple[Service, ...]:
    """The services to start, in their order; the console derives from them which robots are emulated."""
    from deltaq_deploy.launch.services import (
        Role,
        cell_services,
        console_is_installed,
        console_service,
        recorder,
        select,
        video_services,
    )

    services = (*cell_services(description, cell, real, audit), *video_services(description, cell))
    if record:
        services = (*services, recorder(cell, record))
    if with_console and console_is_installed():
        services = (*services, console_service(description, cell, services, recordings))
    if only:
        services = select(services, only)
        if any(service.role is Role.CONSOLE for service in services):
            others = tuple(service for service in services if service.role is not Role.CONSOLE)
            services = (*others, console_service(description, cell, others, recordings))
    return services


def _refuse_unsafe(description: CellDescription, cell: str, services: Sequence[Service], real: bool) -> None:
    """Refuse a cell that cannot be that of real robots, an open realm without tokens, and tokens in the clear."""
    from deltaq_cell.find import find_cell
    from deltaq_deploy.launch.prepare import refuse_unreal
    from deltaq_deploy.launch.services import Role
    from deltaq_services.hli.client_roles import client_roles
    from deltaq_services.hli.line_encryption import line_encryption

    if real:
        servers = [service for service in services if service.role is Role.ROBOT_SERVER]
        refuse_unreal(description, find_cell(cell), [server.robot for server in servers if server.robot])
    if any(service.role is Role.HLI for service in services):
        client_roles(description)
        line_encryption(description)


def audit_file_of(wanted: str, cell: str) -> tuple[Path | None, str]:
    """The file of the audit log, or why there is none: a cell starts also without a folder for logs."""
    from deltaq_services.hli.audit import AuditFileError, default_audit_file

    if wanted:
        return Path(wanted).resolve(), ""
    try:
        return default_audit_file(cell), ""
    except AuditFileError as error:
        return None, str(error)


def tell_of_console(launcher: Launcher, wanted: bool) -> str | None:
    """Print the console's address, or why there is none; returns its address for this machine's browser."""
    for service in launcher.services:
        if service.name == "console" and service.name in launcher.ready and service.endpoint is not None:
            token = launcher.console_token
            launcher.say(f"the console is at {service.endpoint}{token.query if token else ''}")
            return token.page(service.endpoint) if token else service.endpoint
    from deltaq_deploy.launch.services import console_is_installed

    if wanted and not console_is_installed():
        launcher.say("no console: `pip install 'deltaq[console]'` installs its libraries")
    return None


def watch(launcher: Launcher, cell: str) -> list[str]:
    """Wait for a signal, or until no service is left; returns the services that ended on their own."""
    from deltaq_deploy.launch.child_process import Exited, Ready
    from deltaq_deploy.launch.launcher import Interrupted, describe_exit

    ended: list[str] = []
    while len(ended) < len(launcher.children):
        match launcher.wait():
            case Ready("console"):
                tell_of_console(launcher, wanted=True)
            case Interrupted(number):
                launcher.say(f"{number.name}: bringing the robots to rest, then ending the services")
                return ended
            case Exited(name, status):
                ended.append(name)
                again = f"deltaq up --cell {cell} --only {name}"
                launcher.say(f"{describe_exit(name, status)}; the others continue; `{again}` starts it again")
    return ended
