"""`deltaq demo`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.console import (
    console,
    counts,
    flat,
    prefixed_log,
    print_json,
    print_table,
    progress_bar,
    shown_compiled_ahead,
)
from deltaq_deploy.command.options import CellOption, ConsoleOption, JsonOption
from deltaq_deploy.command.up import tell_of_console
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from rich.console import Console

    from deltaq_cell.description import CellDescription
    from deltaq_deploy.launch.launcher import Launcher
    from deltaq_deploy.launch.rates import Track
    from deltaq_protocol.messages import RobotStatus, Status

TICK_S = 0.25
TOLD_EVERY_S = 10.0
SETTLED_S = 1.0
"""The admission rate counts from here: a controller that serves has yet to take its lease."""


def demo(
    cell: CellOption = "lab",
    duration_s: Annotated[
        float,
        typer.Option(min=1.0, envvar="DEMO_S", help="How long the leader moves and the camera follows."),
    ] = 60.0,
    open_console: Annotated[
        bool, typer.Option("--open", help="Open the console in this machine's browser.")
    ] = False,
    with_console: ConsoleOption = True,
    verbose: Annotated[bool, typer.Option("--verbose", help="Also print figures and counters.")] = False,
    json: JsonOption = False,
) -> None:
    """Start an emulated cell; a scripted leader moves one arm, and the other follows it with its camera."""
    import webbrowser

    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.bring_to_rest import bring_to_rest
    from deltaq_deploy.launch.launcher import Launcher
    from deltaq_deploy.launch.prepare import needed_by
    from deltaq_deploy.launch.services import (
        cell_services,
        console_is_installed,
        console_service,
        demo_controllers,
    )

    description = load_cell(cell)
    services = (*cell_services(description, cell), *demo_controllers(description))
    if with_console and console_is_installed():
        services = (*services, console_service(description, cell, services))
    output = console(sys.stderr)
    shown = prefixed_log(output, [service.name for service in services])

    def log(name: str, line: str) -> None:
        if verbose or not line.startswith("{"):  # figures of a controller that has ended
            shown(name, line)

    launcher = Launcher(services, log, partial(bring_to_rest, description, "deltaq demo"))
    with shown_compiled_ahead(needed_by(services, description, cell)), launcher:
        launcher.say(f"starting {len(services)} services")
        launcher.start()
        launcher.say(
            f"cell {description.cell} is up; the camera follows for {duration_s:g} s, Ctrl-C ends it"
        )
        address = tell_of_console(launcher, with_console)
        if open_console and address is not None:
            webbrowser.open(address)
        summary, problems = _follow(launcher, description, duration_s, output)
    if launcher.unrested:
        problems.append(f"the robots could not be asked to rest: {launcher.unrested}")
    if json:
        print_json(summary)
    else:
        if verbose:
            show(summary)
        for line in in_words(summary):
            typer.echo(line)
    for problem in problems:
        typer.echo(f"deltaq: {problem}", err=True)
    if problems:
        raise typer.Exit(BAD)


def _follow(
    launcher: Launcher, cell: CellDescription, duration_s: float, output: Console
) -> tuple[dict[str, Any], list[str]]:
    from deltaq_deploy.launch.cell_connection import connect, listen
    from deltaq_deploy.launch.rates import Observer

    def ask() -> Status:
        with connect(cell, "deltaq demo") as running:
            return running.status()

    statuses = [ask()]
    with listen(cell) as listener:
        observer = Observer(listener, tuple(cell.robots))
        problems = _wait(launcher, duration_s, output, lambda: statuses.append(ask()))
        observer.close()
    before, status = statuses[-1], ask()
    # each prints its figures as it ends
    launcher.stop_service("follower")
    launcher.stop_service("leader")
    summary = summarise(cell, observer.tracks, before, status, launcher.last_json("follower"))
    still = [name for name, track in observer.tracks.items() if not any(track.travel)]
    return summary, [*problems, *(f"{name} did not move" for name in still)]


def _wait(
    launcher: Launcher, duration_s: float, output: Console, on_settled: Callable[[], None]
) -> list[str]:
    """Show progress until the time is over, a service ends or a signal comes; returns the problems.

    `on_settled` is called once, when the controllers have begun.
    """
    from deltaq_deploy.launch.child_process import Exited, Ready
    from deltaq_deploy.launch.launcher import Interrupted, describe_exit

    begin = time.monotonic()
    told_s, settled = 0.0, False
    with progress_bar("the camera follows") as move:
        while (elapsed := time.monotonic() - begin) < duration_s:
            move(round(elapsed * 1e3), round(duration_s * 1e3))
            if not settled and elapsed >= SETTLED_S:
                settled = True
                on_settled()
            if not output.is_terminal and elapsed - told_s >= TOLD_EVERY_S:
                told_s = elapsed
                launcher.say(f"{elapsed:.0f} of {duration_s:g} s")
            match launcher.wait(min(TICK_S, duration_s - elapsed)):
                case Interrupted(number):
                    launcher.say(f"{number.name}: bringing the robots to rest")
                    return []
                case Ready("console"):
                    tell_of_console(launcher, wanted=True)
                case Exited("console", status):
                    launcher.say(
                        f"{describe_exit('console', status)}; the demonstration continues without it"
                    )
                case Exited(name, status):
                    return [f"{describe_exit(name, status)} during the demonstration"]
    return []


def admission_rate(before: RobotStatus, after: RobotStatus) -> float | None:
    """Share of a robot's cycles between two statuses in which a fresh, admitted increment reached it.

    None if there was no cycle, or its Robot Server was restarted in between.
    """
    cycles = after.cycle - before.cycle
    admissions = after.counters.get("admissions", 0) - before.counters.get("admissions", 0)
    return admissions / cycles if cycles > 0 and admissions >= 0 else None


def summarise(
    cell: CellDescription,
    tracks: dict[str, Track],
    before: Status,
    status: Status,
    tracking: dict[str, Any] | None,
) -> dict[str, Any]:
    """The figures of a demonstration, as `--json` prints them, from the statuses at its begin and at its end."""
    return {
        "cell": cell.cell,
        "cycle_s": cell.cycle_s,
        "robots": {
            name: {
                "phase": status.robots[name].phase.value,
                "cycles": asdict(track.rate),
                "missed": track.missed,
                "admission_rate": admission_rate(before.robots[name], status.robots[name]),
                "travel": track.travel,
                "counters": status.robots[name].counters,
            }
            for name, track in tracks.items()
        },
        "tracking": tracking,
        "gate": status.gate,
        "hli": status.hli,
    }


PAPER_ANGLE_DEG, PAPER_DISTANCE_CM = 1.0, 2.0
"""Within which the camera of Bjerkeng et al. (2011), section VI-C, kept its view."""
NEXT = (
    "next: `deltaq up`, then `deltaq drive --robot gr` or `deltaq run FILE.py:Class --robot fr` in another terminal; "
    "`deltaq demo --verbose` prints all figures"
)


def in_words(summary: dict[str, Any]) -> tuple[str, ...]:
    """The result of a demonstration, as four lines of text."""
    gate = summary["gate"]
    counts = {name: gate.get(name, 0) for name in ("admitted", "scaled", "held", "refused")}
    missed = [
        f"{name} missed {robot['missed'] or 'none'} of its {robot['missed'] + robot['cycles']['count']} cycles"
        + ("" if (rate := robot["admission_rate"]) is None else f" and moved as admitted in {rate:.1%}")
        for name, robot in summary["robots"].items()
    ]
    return (
        f"camera: {_followed(summary['tracking'])}",
        f"gate: it admitted {counts['admitted']} increments in full, limited {counts['scaled']}, "
        f"replaced {counts['held']} by braking and refused {counts['refused']}",
        f"cycles of {summary['cycle_s'] * 1000:g} ms, as a client saw them: {'; '.join(missed)}",
        NEXT,
    )


def _followed(tracking: dict[str, Any] | None) -> str:
    """How well the camera followed, beside the paper."""
    from deltaq_protocol.messages import Sight

    if not tracking:
        return "it reported no figures"
    angle_deg, distance_m = tracking["angle_deg"], tracking["distance_m"]
    if angle_deg["rms"] is None:
        return "it followed for too short a time to judge it; let the demo run for more than 5 s"
    told = (
        f"it kept the target within {angle_deg['rms']:.2f}° and {100 * distance_m['rms']:.1f} cm (rms; at most "
        f"{angle_deg['max']:.2f}° and {100 * distance_m['max']:.1f} cm), the paper within {PAPER_ANGLE_DEG:g}° and "
        f"{PAPER_DISTANCE_CM:g} cm"
    )
    view = tracking["view"]
    looked = sum(view[sight.value] for sight in Sight)
    seen = view[Sight.FRESH] + view[Sight.OUT_OF_REACH]
    return f"{told}; it saw the target in {seen / looked:.0%} of the cycles" if looked else told


def show(summary: dict[str, Any]) -> None:
    """Print figures and counters."""

    def ms(value: float | None) -> str | None:
        return None if value is None else f"{value * 1000:.2f}"

    periods = ("period_median_s", "period_p99_s", "period_max_s")
    rows = [
        (name, robot["cycles"]["count"], robot["missed"], *(ms(robot["cycles"][each]) for each in periods))
        for name, robot in summary["robots"].items()
    ]
    print_table(
        f"cycles of {summary['cycle_s'] * 1000:g} ms, as a client saw them",
        ("robot", "seen", "missed", "median ms", "p99 ms", "longest ms"),
        rows,
    )
    for name, robot in summary["robots"].items():
        if (rate := robot["admission_rate"]) is not None:
            print(
                f"{name}: a fresh increment that the gate had admitted reached the robot in {rate:.2%} of its cycles; "
                "in the others it braked along a path that had been checked before"
            )
    tracking = summary["tracking"]
    if tracking:
        print_table("tracking", ("what", "value"), flat(tracking))
    print(f"gate: {counts(summary['gate'])}")
    print(f"hli: {counts(summary['hli'])}")
    for name, robot in summary["robots"].items():
        print(f"{name}: {counts(robot['counters'])}")
