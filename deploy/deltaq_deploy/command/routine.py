"""`deltaq routine`: inspection and maintenance routines."""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.options import CellOption, JsonOption, TokenOption, UrlOption
from deltaq_deploy.launch import BAD, INTERRUPTED

if TYPE_CHECKING:
    from deltaq_controllers.routines.run import RoutineRun

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that bring the robot to rest where the routine can be resumed."""

RobotsOption = Annotated[
    str, typer.Option("--robot", help="Robot that works; by default the one of the equipment.")
]


def list_routines(cell: CellOption = "lab", url: UrlOption = None, json: JsonOption = False) -> None:
    """List the routines, and what they can be done on in a cell; and the last run on each item."""
    from deltaq_controllers.routines.routine import load_routine, shipped
    from deltaq_controllers.routines.shell import runs_of
    from deltaq_deploy.command.console import print_json, print_table
    from deltaq_deploy.launch.cell_connection import described

    description = described(cell, url, "deltaq routine")
    routines = {name: load_routine(name)[1] for name in shipped()}
    last = {run["equipment"]: run for run in runs_of(description.cell)}
    rows: list[dict[str, Any]] = []
    for name, routine in routines.items():
        items = [each for each, item in description.equipment.items() if item.kind in routine.kinds]
        parameters = {each: parameter.default for each, parameter in routine.parameters.items()}
        rows.append({"routine": name, "title": routine.title, "equipment": items, "parameters": parameters})
    history = {
        name: {"kind": item.kind, "last": last.get(name)} for name, item in description.equipment.items()
    }
    if json:
        print_json({"cell": description.cell, "routines": rows, "equipment": history})
        return
    print_table(
        f"routines in {description.cell}",
        ("routine", "what it does", "equipment", "parameters"),
        (
            (
                row["routine"],
                row["title"],
                ", ".join(row["equipment"]) or ("none needed" if not routines[row["routine"]].kinds else "-"),
                " ".join(f"{each}={value:g}" for each, value in row["parameters"].items()),
            )
            for row in rows
        ),
    )
    for item in filter(last.get, history):
        done = last[item]
        typer.echo(f"{item}: {done['routine']} at {done['time']}: {done['why'] or done['end']}")


def run(
    routine: Annotated[str, typer.Argument(help="A routine (`deltaq routine list`), or a YAML file.")],
    equipment: Annotated[str, typer.Argument(help="Item of equipment, where the routine is for one.")] = "",
    parameters: Annotated[
        list[str] | None, typer.Argument(metavar="NAME=NUMBER", help="Parameters of the routine.")
    ] = None,
    robot: RobotsOption = "",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Plan every motion from where the robot is, and move nothing.")
    ] = False,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Run a routine; Ctrl-C brings the robot to rest, and `deltaq routine resume` goes on from that step."""
    words = [equipment, *(parameters or [])]
    names = [word for word in words if word and "=" not in word]
    if len(names) > 1:
        raise typer.BadParameter(f"one item of equipment, got {', '.join(names)}", param_hint="EQUIPMENT")
    numbers = dict(_number(word) for word in words if "=" in word)
    _run((cell, url, token), json, (routine, "".join(names), robot, 0, numbers), dry_run=dry_run)


def resume(
    robot: RobotsOption = "",
    abort: Annotated[
        bool, typer.Option("--abort", help="Do not go on: back out to a safe pose, and end the routine.")
    ] = False,
    cell: CellOption = "lab",
    url: UrlOption = None,
    token: TokenOption = None,
    json: JsonOption = False,
) -> None:
    """Go on with the last routine from the step at which it ended, or give it up; after a stop, reset first."""
    from deltaq_controllers.routines.shell import unfinished
    from deltaq_deploy.launch.cell_connection import described

    last = unfinished(described(cell, url, "deltaq routine").cell, robot)
    what = (last["source"], last["equipment"] or "", last["robot"], last["place"], last["numbers"])
    typer.echo(f"{last['routine']}: step {last['place'] + 1} of {last['steps']}", err=True)
    _run((cell, url, token), json, what, abort=abort)


def _number(text: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError:
        raise typer.BadParameter(f"NAME=NUMBER, got {text!r}", param_hint="PARAMETERS") from None


def _run(
    reached: tuple[str, str | None, str | None],
    json: bool,
    what: tuple[str, str, str, int, dict[str, float]],
    dry_run: bool = False,
    abort: bool = False,
) -> None:
    """Run, plan or give up a routine.

    Args:
        reached: the cell, its URL and the token.
        json: print the report as JSON.
        what: routine, equipment, robot, first step and numbers, as `LiveRoutine` takes them.
        dry_run: plan it, and move nothing.
        abort: give it up.
    """
    import asyncio

    from deltaq_controllers.answers import lease
    from deltaq_controllers.live import control_loop
    from deltaq_controllers.routines.run import RunEnd
    from deltaq_controllers.routines.shell import LiveRoutine
    from deltaq_deploy.command.console import print_json
    from deltaq_deploy.launch.cell_connection import Where, check_same
    from deltaq_protocol import connect

    cell, url, token = reached
    where = Where.of(cell, url, what[2])

    async def driven() -> dict[str, Any]:
        async with connect(where.hli, client="deltaq routine", token=token) as running:
            check_same(where, running.description)
            live = LiveRoutine(running, *what)
            if dry_run:
                return await live.rehearse()
            if abort:
                live.run.abort()
            for number in _ENDING:
                asyncio.get_running_loop().add_signal_handler(number, live.run.leave, "interrupted")
            told = _Progress()
            with control_loop():
                async with await lease(running, live.job.robot) as leased:
                    await live.drive(leased, told.show)
            told.end()
            return live.report()

    report = asyncio.run(driven())
    if json:
        print_json(report)
    else:
        _show(report)
    if report["end"] == RunEnd.LEFT:
        raise typer.Exit(INTERRUPTED)
    if report["end"] not in (RunEnd.DONE, RunEnd.ABORTED if abort else None, "planned"):
        raise typer.Exit(BAD)


class _Progress:
    """Tells each step on standard error: in one line that changes on a terminal, else when a step is over."""

    def __init__(self) -> None:
        self._is_terminal, self._told, self._line = sys.stderr.isatty(), 0, ""

    def show(self, run: RoutineRun) -> None:
        """Tell what is new."""
        start = "\r\x1b[2K" if self._is_terminal else ""
        for outcome in run.outcomes[self._told :]:
            why = f": {outcome.why}" if outcome.why else ""
            print(f"{start}{_line(outcome.as_dict())}{why}", file=sys.stderr, flush=True)
        self._told = len(run.outcomes)
        if self._is_terminal and run.present is not None and run.end is None:
            line = f"{run.present.text} {run.done:4.0%}"
            if line != self._line:
                self._line = line
                sys.stderr.write(f"{start}{line}")
                sys.stderr.flush()

    def end(self) -> None:
        """Leave no half line."""
        if self._is_terminal:
            sys.stderr.write("\r\x1b[2K")


def _line(outcome: dict[str, Any]) -> str:
    near = ""
    if outcome["clearance_m"] is not None:
        near = f", {1000 * outcome['clearance_m']:.0f} mm between {' and '.join(outcome['pair'])}"
    sight = f", {outcome['sight']}" if outcome["sight"] else ""
    return f"{outcome['number']:3d} {outcome['end']:12} {outcome['seconds']:6.1f} s  {outcome['text']}{near}{sight}"


def _show(report: dict[str, Any]) -> None:
    what = f"{report['routine']} {report['equipment'] or ''}".strip()
    if report["end"] == "planned":
        for outcome in report["outcomes"]:
            typer.echo(_line(outcome))
        typer.echo(f"the gate would now admit: {report['gate'] or 'nothing moves'}")
    seconds = sum(outcome["seconds"] for outcome in report["outcomes"])
    typer.echo(f"{what} by {report['robot']}: {report['end']}, {seconds:.1f} s")
    if report["why"]:
        typer.echo(report["why"])
        if report["place"] < report["steps"]:
            typer.echo("when the cause is gone: `deltaq reset` if it is held, then `deltaq routine resume`")
