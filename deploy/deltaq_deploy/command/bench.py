"""`deltaq bench`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.options import CellOption, JsonOption
from deltaq_deploy.launch.exit_status import BAD

if TYPE_CHECKING:
    from deltaq_experiments.bench.live import LiveOptions, LiveRun
    from deltaq_experiments.bench.table import BenchTable


def bench(
    cell: CellOption = "lab",
    cycles: Annotated[int, typer.Option(min=10, help="Cycles of tracking that are timed.")] = 400,
    live: Annotated[
        bool, typer.Option("--live", help="Run the cell, and time each increment on its way through it.")
    ] = False,
    follower: Annotated[str, typer.Option(help="Live: the follower's camera controller.")] = "qp",
    duration_s: Annotated[float, typer.Option(min=0.5, help="Live: duration of the measurement.")] = 60.0,
    warm_up_s: Annotated[float, typer.Option(min=0.0, help="Live: time before the measurement.")] = 10.0,
    runs: Annotated[int, typer.Option(min=1, help="Live: number of runs; each is reported.")] = 1,
    json: JsonOption = False,
) -> None:
    """Measure against references in the same run; exit status 1 if a bound is not kept."""
    if live:
        from deltaq_experiments.bench.live import LiveOptions

        options = LiveOptions(cell, follower, warm_up_s, duration_s)
        good = _live(options, runs, json)
    else:
        good = _alone(cell, cycles, json)
    if not good:
        raise typer.Exit(BAD)


def _alone(cell: str, cycles: int, json: bool) -> bool:
    from deltaq_deploy.command.console import print_json
    from deltaq_deploy.command.progress import progress_bar, shown_compiled_ahead
    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.bench.measure import run

    with shown_compiled_ahead(Needed()), progress_bar("measuring") as move:
        table = run(cell, cycles, move)
    if json:
        print_json(table.model_dump(mode="json") | {"good": table.good})
    else:
        show(table)
    return table.good


def show(table: BenchTable) -> None:
    """The rows as people read them."""
    from deltaq_deploy.command.console import print_table

    columns = (
        "what",
        "reference",
        "median us",
        "reference us",
        "median",
        "p99",
        "p99.9",
        "longest",
        "bounds",
    )
    rows = [
        (
            row.what,
            row.reference,
            f"{row.median_us:.0f}",
            f"{row.reference_us:.0f}",
            f"{row.median_ratio:.2f}",
            f"{row.p99_ratio:.2f}",
            f"{row.p99_9_ratio:.2f}",
            f"{row.longest_ratio:.2f}",
            ", ".join(
                f"{name} {bound:g}{'' if ratio <= bound else ' MISSED'}"
                for name, (ratio, bound) in row.bounds.items()
            )
            or None,
        )
        for row in table.rows
    ]
    print_table("figures as multiples of their reference", columns, rows)


def _live(options: LiveOptions, runs: int, json: bool) -> bool:
    from deltaq_deploy.command.console import console, print_json
    from deltaq_deploy.command.progress import progress_bar, shown_compiled_ahead
    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.bench.live import run_once

    output = console(sys.stderr)
    told: list[LiveRun] = []
    length_s = options.warm_up_s + options.duration_s
    with shown_compiled_ahead(Needed([options.follower])):
        for number in range(1, runs + 1):
            with progress_bar(f"run {number} of {runs}") as move:
                told.append(
                    run_once(options, lambda time_s: move(round(time_s * 1e3), round(length_s * 1e3)))
                )
            if runs > 1 and not json:
                output.print(f"run {number} of {runs} is done")
    good = all(run.good for run in told)
    if json:
        print_json(
            {
                "cell": options.cell,
                "follower": options.follower,
                "duration_s": options.duration_s,
                "warm_up_s": options.warm_up_s,
                "runs": [run.model_dump(mode="json") | {"good": run.good} for run in told],
                "good": good,
            }
        )
    else:
        for number, run in enumerate(told, start=1):
            show_run(run, number)
    return good


def show_run(run: LiveRun, number: int) -> None:
    """One live run as people read it."""
    from deltaq_deploy.command.console import print_table

    for name, robot in run.robots.items():
        columns = ("station", "passed", "missing", "p50", "p99", "p99.9", "longest", "hops", "p50 x", "p99 x")
        rows = [
            (
                station.station,
                station.age_ms.count,
                station.missing,
                _text(station.age_ms.p50),
                _text(station.age_ms.p99),
                _text(station.age_ms.p99_9),
                _text(station.age_ms.longest),
                station.hops,
                _text(station.ratio_p50, 1),
                _text(station.ratio_p99, 1),
            )
            for station in robot.stations
        ]
        print_table(f"run {number}, {name}: ms since the telegram that an increment answers", columns, rows)
        if robot.braked:
            title = f"run {number}, {name}: {robot.cycles - robot.fresh} of {robot.cycles} cycles without an admission"
            print_table(title, ("because", "cycles"), robot.braked.items())
    spent = sorted(run.processor_us.items(), key=lambda item: -item[1])
    title = f"run {number}: processor time of a cycle"
    print_table(title, ("process", "µs"), [(name, f"{us:.0f}") for name, us in spent])
    figures = [
        (
            row.what,
            f"{_text(row.value)} {row.unit}",
            f"{_text(row.reference)} {row.unit}",
            _text(row.ratio),
            _bound(row.at_least, row.at_most, row.unit),
            {None: None, True: "kept", False: "MISSED"}[row.kept],
        )
        for row in run.rows
    ]
    reference = f"{run.reference['language']}, same hops"
    print_table(f"run {number}: figures", ("what", "here", reference, "ratio", "bound", ""), figures)
    for process in run.silent:
        print(f"{process} left no stamps: its stations are missing")
    if run.overwritten:
        print(f"{run.overwritten} of the earliest stamps were lost: measure for a shorter time")


def _text(value: float | None, digits: int = 2) -> str | None:
    return None if value is None else f"{value:.{digits}f}"


def _bound(at_least: float | None, at_most: float | None, unit: str) -> str | None:
    if at_least is not None:
        return f"at least {at_least:g} {unit}"
    return None if at_most is None else f"at most {at_most:g} {unit}"
