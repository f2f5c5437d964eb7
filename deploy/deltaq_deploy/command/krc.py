"""`deltaq krc`: files for a real KRC, its telegrams, and the lag of its drives."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.console import print_json, print_table
from deltaq_deploy.command.options import CellOption, JsonOption, RobotOption
from deltaq_deploy.launch import BAD, UNREACHABLE

if TYPE_CHECKING:
    from deltaq_cell.description import CellDescription, RsiDescription
    from deltaq_deploy.krc import KrcFile, KrcPlan, Start
    from deltaq_deploy.rsi.listen import Spread, Summary
    from deltaq_protocol.rsi import EthernetConfig


def write_krc_files(
    robot: RobotOption,
    output: Annotated[Path, typer.Option(metavar="FOLDER", help="Write the files into this folder.")],
    cell: CellOption = "lab",
    start: Annotated[
        str, typer.Option(help="Where RSI starts: `home`, to which the program moves first, or `here`.")
    ] = "home",
    rsi: Annotated[int | None, typer.Option(help="Generation of RSI: 2, 3, or 4 for all later ones.")] = None,
    address: Annotated[
        str | None,
        typer.Option(help="The PC's address as the KRC sees it; by default the cell's driver.address."),
    ] = None,
    limit_deg: Annotated[
        float | None,
        typer.Option(min=0.001, help="Largest correction of a rotating axis; for the first motion."),
    ] = None,
    limit_mm: Annotated[float | None, typer.Option(min=0.001, help="The same for linear axes.")] = None,
    digital: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=NUMBER", help="The KRC's $IN or $OUT of a digital signal; repeatable."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    json: JsonOption = False,
) -> None:
    """Write the files for a real KRC from the cell: program, context and `*_ethernet.xml`."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.krc import files_of, plan_for, write_files
    from deltaq_deploy.launch.cell_connection import known_robot

    description = load_cell(cell)
    known_robot(description, robot)
    plan = plan_for(
        description,
        robot,
        start=_start(start),
        rsi=rsi,
        address=address,
        limit_deg=limit_deg,
        limit_mm=limit_mm,
        digital=_numbers(digital or []),
    )
    files = files_of(plan)
    write_files(files, output, force=force)
    _tell(plan, files, output, json)


def _start(text: str) -> Start:
    from deltaq_deploy.krc import KrcFilesError, Start

    if text not in list(Start):
        raise KrcFilesError(f"--start is {text!r}, allowed is {' or '.join(Start)}")
    return Start(text)


def _numbers(pairs: list[str]) -> dict[str, int]:
    from deltaq_deploy.krc import KrcFilesError

    numbers = {}
    for pair in pairs:
        name, _, number = pair.partition("=")
        if not number.isdecimal():
            raise KrcFilesError(f"--digital is {pair!r}, must be NAME=NUMBER such as gripper=12")
        numbers[name] = int(number)
    return numbers


def _tell(plan: KrcPlan, files: tuple[KrcFile, ...], folder: Path, json: bool) -> None:
    from deltaq_deploy.krc.files import notes_on
    from deltaq_deploy.krc.plan import written_for

    notes = list(notes_on(plan))
    if json:
        listed = [
            {"file": str(folder / file.name), "copy_to": file.copy_to or None, "what": file.what}
            for file in files
        ]
        print_json(
            {
                "cell": plan.cell,
                "robot": plan.robot,
                "krc": plan.krc,
                "rsi": plan.rsi,
                "start": plan.start,
                "files": listed,
                "notes": notes,
            }
        )
        return
    typer.echo(f"{plan.robot} of {plan.cell}, for {written_for(plan)}, {plan.cycle_ms} ms:")
    for file in files:
        typer.echo(f"  {folder / file.name}: {file.what}")
        typer.echo(f"    copy to {file.copy_to}" if file.copy_to else "    stays here")
    for note in notes:
        typer.echo(f"note: {note}")


AddressOption = Annotated[
    str | None, typer.Option(help="Listen on this address; by default the cell's driver.address, or 0.0.0.0.")
]
PortOption = Annotated[
    int | None,
    typer.Option(min=1, max=65535, help="Listen on this UDP port; by default the cell's driver.port."),
]
DurationOption = Annotated[float, typer.Option(min=0.0, help="Duration; 0: until Ctrl-C.")]


def sniff(
    address: AddressOption = None,
    port: PortOption = None,
    cell: Annotated[str, typer.Option(help="Compare with this cell's file; needs --robot.")] = "",
    robot: Annotated[str, typer.Option(help="The robot of the cell; needs --cell.")] = "",
    duration_s: DurationOption = 10.0,
    json: JsonOption = False,
) -> None:
    """Listen to a KRC without answering; it stops RSI after its permitted number of late replies."""
    from deltaq_deploy.rsi.listen import WireStatistics, listen

    if cell or robot:
        description, driver, config = _of_cell(cell, robot)
        statistics = WireStatistics(_listed(config), description.cycle_s)
        address, port = address or driver.address, port or driver.port
    else:
        statistics = WireStatistics()
    address = address or "0.0.0.0"  # a first look does not know which interface it will come by
    if port is None:
        raise typer.BadParameter("give --port, or --cell and --robot")
    listen(address, port, duration_s, statistics, ready=lambda: _say(address, port, json))
    _report(statistics.summary(), address, port, json, {})


def echo(
    robot: RobotOption,
    cell: CellOption = "lab",
    address: AddressOption = None,
    port: PortOption = None,
    duration_s: DurationOption = 10.0,
    json: JsonOption = False,
) -> None:
    """Answer a KRC with corrections of zero only; a robot that has left its start gets no answer."""
    from deltaq_cell.krc_files import station_of
    from deltaq_deploy.rsi.listen import WireStatistics, ZeroEcho, listen
    from deltaq_protocol.rsi import SensorCodec

    description, driver, config = _of_cell(cell, robot)
    zeros = ZeroEcho(SensorCodec(config, station_of(description.robots[robot], driver).axes))
    statistics = WireStatistics(_listed(config), description.cycle_s)
    address, port = address or driver.address, port or driver.port
    listen(address, port, duration_s, statistics, zeros.answer, lambda: _say(address, port, json))
    _report(statistics.summary(), address, port, json, zeros.refusals)


def _of_cell(cell: str, robot: str) -> tuple[CellDescription, RsiDescription, EthernetConfig]:
    from deltaq_cell.description import RsiDescription
    from deltaq_cell.find import find_cell, resolve_near
    from deltaq_cell.load import load_cell
    from deltaq_deploy.krc import KrcFilesError
    from deltaq_deploy.launch.cell_connection import known_robot
    from deltaq_protocol.rsi import load_ethernet_xml

    if not cell or not robot:
        raise typer.BadParameter("--cell and --robot go together")
    description = load_cell(cell)
    known_robot(description, robot)
    driver = description.robots[robot].driver
    if not isinstance(driver, RsiDescription):
        raise KrcFilesError(
            f"robot {robot} of cell {description.cell} has no KRC: its driver is {driver.kind}"
        )
    return description, driver, load_ethernet_xml(resolve_near(find_cell(cell), driver.ethernet_xml))


def _listed(config: EthernetConfig) -> tuple[str, ...]:
    from deltaq_protocol.rsi.layout import send_fields

    return tuple(
        field.group if field.attribute is None else f"{field.group}.{field.attribute}"
        for field in send_fields(config)
    )


def _say(address: str, port: int, json: bool) -> None:
    typer.echo(f"listening on UDP {address}:{port}; Ctrl-C ends it", err=json)


def _report(summary: Summary, address: str, port: int, json: bool, refusals: dict[str, int]) -> None:

    hints = _hints(address, port) if not summary.peers else ()
    if json:
        print_json(asdict(summary) | {"unanswered": refusals, "hints": hints})
    else:
        print_table(f"UDP {address}:{port}", ("what", "seen"), _rows(summary))
        for problem in summary.problems:
            typer.echo(f"problem: {problem}")
        for reason, count in refusals.items():
            typer.echo(f"not answered, {count} times: {reason}")
        for hint in hints:
            typer.echo(f"no telegram came: {hint}")
    if not summary.peers:
        raise typer.Exit(UNREACHABLE)
    if summary.problems or refusals:
        raise typer.Exit(BAD)


def _hints(address: str, port: int) -> tuple[str, ...]:
    return (
        f"is the program on the KRC past its HALT and in RSI_MOVECORR or ST_SKIPSENS, and are IP_NUMBER and PORT of "
        f"its *_ethernet.xml this machine's address and {port}?",
        f"does a firewall here let UDP {port} in (`nft list ruleset`, `ufw status`, Windows Defender)?",
        f"is {address} on the interface that the robot's network is plugged into, and does the KRC answer a ping?",
    )


def _rows(summary: Summary) -> list[tuple[str, Any]]:
    peers = ", ".join(f"{peer} ({count})" for peer, count in summary.peers.items())
    return [
        ("telegrams", summary.telegrams),
        ("a second", None if summary.rate_hz is None else f"{summary.rate_hz:.1f}"),
        ("cycle [ms]", _shown(summary.cycle)),
        ("late by half a cycle", summary.late),
        ("replies [ms]", _shown(summary.reply)),
        ("IPOC step", summary.ipoc_step),
        ("IPOC jumps", summary.ipoc_jumps),
        ("Delay", summary.delay),
        ("Delay grew by", summary.delay_growth),
        ("decimals", summary.decimals),
        ("garbled", summary.garbled),
        ("senders", peers or None),
        ("elements", " ".join(dict.fromkeys(name.partition(".")[0] for name in summary.elements)) or None),
        ("looks like", summary.guess),
    ]


def _shown(spread: Spread | None) -> str | None:
    if spread is None:
        return None
    median, p99, longest = (value * 1e3 for value in (spread.median_s, spread.p99_s, spread.longest_s))
    return f"median {median:.2f}, p99 {p99:.2f}, longest {longest:.2f}"
