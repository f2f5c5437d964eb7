"""`deltaq krc`: files for a real KRC, its telegrams, and the lag of its drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.krc_lag import LAG_EXAMPLES, lag
from deltaq_deploy.command.options import JsonOption, RobotOption
from deltaq_deploy.command.rsi import echo, sniff

if TYPE_CHECKING:
    from deltaq_deploy.krc import KrcFile, KrcPlan, Start


krc = typer.Typer(
    help="Bring up a real KRC: its files, its telegrams, the lag of its drives.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
krc.command()(sniff)
krc.command()(echo)
krc.command(epilog=LAG_EXAMPLES)(lag)


@krc.command("files")
def write_krc_files(
    cell: Annotated[str, typer.Argument(help="Name of a shipped cell or path of a YAML file.")],
    robot: RobotOption,
    to: Annotated[Path, typer.Option(metavar="FOLDER", help="Write the files into this folder.")],
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
    write_files(files, to, force=force)
    _tell(plan, files, to, json)


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
    from deltaq_deploy.command.console import print_json
    from deltaq_deploy.krc.files import notes_on
    from deltaq_deploy.krc.header import written_for

    notes = notes_on(plan)
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
