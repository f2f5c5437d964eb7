"""`deltaq fault`."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.console import print_json, print_table, progress_bar
from deltaq_deploy.command.options import CellOption, JsonOption, RobotOption
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from deltaq_testing.faults.catalogue import Fault
    from deltaq_testing.scenario.run import ScenarioOutcome


# `deltaq fault run` and `deltaq fault search`: scenario files for a controller of one's own.

FaultSeedOption = Annotated[
    int | None,
    typer.Option(min=0, max=2**32 - 1, help="Seed in place of the file's; the same seed gives the same run."),
]


def run(
    files: Annotated[list[Path], typer.Argument(help="Scenario files.", metavar="FILE...")],
    seed: FaultSeedOption = None,
    junit: Annotated[Path | None, typer.Option(help="JUnit XML file to write.")] = None,
    html: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    json: JsonOption = False,
) -> None:
    """Run scenarios in virtual time: faults for your controller; exit status 1 if an expectation was not met."""
    from deltaq_testing.scenario.model import load_scenario, write_report
    from deltaq_testing.scenario.page import junit_xml
    from deltaq_testing.scenario.run import Runner

    scenarios = [(file, load_scenario(file)) for file in files]
    outcomes: list[ScenarioOutcome] = []
    for file, scenario in scenarios:
        seeded = scenario if seed is None else scenario.model_copy(update={"seed": seed})
        outcomes.append(Runner(file.resolve().parent).run(seeded, file.name))
    if junit is not None:
        write_report(junit, junit_xml(outcomes))
    if html is not None:
        from deltaq_testing.scenario.page import html_page

        write_report(html, html_page(outcomes))
    if json:
        print_json(
            {"good": all(outcome.good for outcome in outcomes), "scenarios": list(map(_as_map, outcomes))}
        )
    else:
        for outcome in outcomes:
            print_table(_title(outcome), ("expected", "met", "found"), _rows(outcome))
    if not all(outcome.good for outcome in outcomes):
        raise typer.Exit(BAD)


def search(
    file: Annotated[Path, typer.Argument(help="A scenario file; its `search` says which faults are drawn.")],
    examples: Annotated[int, typer.Option(min=1, help="Schedules of faults to draw before giving up.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the schedules.")] = 0,
    output: Annotated[
        Path | None, typer.Option(help="Scenario file to write with the shortest schedule that fails.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Look for faults under which a scenario fails, and shrink them; exit status 1 if there are any."""
    from deltaq_testing.scenario.model import dumped, load_scenario, write_report
    from deltaq_testing.scenario.run import Runner
    from deltaq_testing.strategies import shortest_failure

    scenario, runner = load_scenario(file), Runner(file.resolve().parent)
    with progress_bar(f"schedules of {file.name}") as progress:
        outcome = shortest_failure(
            scenario, runner, file.name, examples, seed, lambda runs: progress(min(runs, examples), examples)
        )
    if json:
        print_json({"good": outcome is None, "shortest": None if outcome is None else _as_map(outcome)})
    if outcome is None:
        if not json:
            typer.echo(f"{file.name}: no schedule failed; {examples} were drawn with seed {seed}")
        return
    if output is not None:
        write_report(output, dumped(outcome.scenario))
    if not json:
        print_table(_title(outcome), ("expected", "met", "found"), _rows(outcome))
        typer.echo("The shortest failing schedule:")
        for entry in outcome.scenario.faults:
            typer.echo(f"  - {{fault: {entry.fault}, at_s: {entry.at_s:g}, for_s: {entry.for_s:g}}}")
    raise typer.Exit(BAD)


def _title(outcome: ScenarioOutcome) -> str:
    cell = outcome.cell
    return f"{outcome.name}: cell {cell.model.description.cell}, robot {cell.robot}, seed {cell.seed}"


def _rows(outcome: ScenarioOutcome) -> list[tuple[str, str, str]]:
    return [(check.what, "yes" if check.finding else "no", check.finding.told) for check in outcome.checks]


def _as_map(outcome: ScenarioOutcome) -> dict[str, object]:
    return {
        "name": outcome.name,
        "good": outcome.good,
        "seed": outcome.cell.seed,
        "faults": [entry.model_dump(mode="json") for entry in outcome.scenario.faults],
        "checks": [
            {"what": check.what, "good": bool(check.finding), "found": check.finding.told}
            for check in outcome.checks
        ],
        "events": [{"time_s": round(time_s, 6), "what": what} for time_s, what in outcome.cell.events],
    }


# `deltaq fault impair`.


UnitOption = Annotated[
    str,
    typer.Option(
        help="Unit that the faults affect: bytes, lines or messages over TCP, datagrams over UDP; "
        "bytes or datagrams if not given."
    ),
]
FaultyOption = Annotated[
    float | None, typer.Option(min=0.0, help="Duration of the faults; to the end if not given.")
]
RelayOption = Annotated[
    float | None, typer.Option(min=0.0, help="Duration of the relay; until Ctrl-C if not given.")
]
RateOption = Annotated[float | None, typer.Option(min=1.0, help="Bytes per second; for a byte stream only.")]
StallOption = Annotated[
    bool, typer.Option("--stall", help="Let nothing pass, and lose nothing; for a byte stream only.")
]
CutOption = Annotated[
    bool, typer.Option("--cut", help="Break connections and refuse new ones; for a byte stream only.")
]


def impair(
    listen: Annotated[
        str,
        typer.Option(
            metavar="ENDPOINT", help="Address at which the relay listens; one party connects or sends here."
        ),
    ],
    to: Annotated[str, typer.Option(metavar="ENDPOINT", help="Address at which the other party listens.")],
    unit: UnitOption = "",
    delay_s: Annotated[float, typer.Option(min=0.0, max=10.0, help="Delay of each unit.")] = 0.0,
    jitter_s: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="Largest additional delay of each unit.")
    ] = 0.0,
    keep_order: Annotated[
        bool,
        typer.Option("--keep-order", help="Keep the order in spite of jitter; a byte stream always does."),
    ] = False,
    loss_share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Fraction that is lost.")] = 0.0,
    duplicate_share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Fraction that is duplicated.")
    ] = 0.0,
    reorder_share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Fraction that is reordered.")] = 0.0,
    corrupt_share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Fraction that is garbled.")] = 0.0,
    rate_bytes_s: RateOption = None,
    stall: StallOption = False,
    cut: CutOption = False,
    after_s: Annotated[float, typer.Option(min=0.0, help="Time until the faults begin.")] = 0.0,
    for_s: FaultyOption = None,
    duration_s: RelayOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
) -> None:
    """Relay a link between two addresses, with delay, loss, duplicates, stalls or cuts.

    It ends with the program that started it.
    """
    import asyncio

    from deltaq_deploy.launch.child_process import while_parent_lives
    from deltaq_protocol.endpoint import Endpoint
    from deltaq_testing.impairment.relay import impair_for_a_while, unit_of, wire_faults

    if keep_order and not jitter_s:
        raise typer.BadParameter(
            "without --jitter-s messages keep their order; give a jitter above 0", param_hint="--keep-order"
        )
    near, far = Endpoint.parse(listen), Endpoint.parse(to)
    chosen = unit_of(near, unit)
    asked: dict[str, Any] = {
        "delay_s": delay_s,
        "jitter_s": jitter_s,
        "keeps_order": keep_order,
        "drop": loss_share,
        "duplicate": duplicate_share,
        "reorder": reorder_share,
        "corrupt": corrupt_share,
        "rate_bytes_s": rate_bytes_s,
        "stalled": stall,
        "cut": cut,
    }
    faults = wire_faults(chosen, {name: value for name, value in asked.items() if value})
    relaying = impair_for_a_while(
        near, far, chosen, faults, typer.echo, after_s=after_s, for_s=for_s, duration_s=duration_s, seed=seed
    )
    with contextlib.suppress(KeyboardInterrupt):  # that is how a relay ends
        asyncio.run(while_parent_lives(relaying))


# `deltaq bench soak`.


MovedOption = Annotated[str | None, typer.Option(help="The robot that moves; by default the cell's first.")]


def soak(
    hours: Annotated[float, typer.Option(min=0.001, max=80.0, help="Duration of the soak.")],
    output: Annotated[
        Path, typer.Option(help="Folder for soak.json and soak.png; made if it does not exist.")
    ],
    cell: CellOption = "lab",
    robot: MovedOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the faults and their times.")] = 0,
    json: JsonOption = False,
) -> None:
    """Inject fault after fault into a cell of real processes; Ctrl-C ends the soak and writes the report so far."""
    from deltaq_testing.scenario.model import must_be_folder, write_report
    from deltaq_testing.soak import SoakRound, figure_of, run_soak

    def tell(one: SoakRound) -> None:
        found = "good" if one.good else f"not good: {one.clear}; {one.limits}; recovered: {one.recovered}"
        if not json:
            typer.echo(f"{one.time_s:8.1f} s  {one.fault}: {found}")

    must_be_folder(output)
    with tempfile.TemporaryDirectory() as folder:
        report = run_soak(Path(folder), cell, robot, hours * 3600.0, seed, tell)
    write_report(output / "soak.json", report.model_dump_json(indent=1) + "\n")
    figure_of(report).savefig(output / "soak.png", dpi=120)
    good = sum(one.good for one in report.rounds)
    if json:
        counts = {"rounds": len(report.rounds), "good_rounds": good}
        print_json({"good": report.good, **counts, "length_s": report.length_s})
    else:
        typer.echo(
            f"{good} of {len(report.rounds)} faults were good in {report.length_s:.0f} s; {output / 'soak.json'}"
        )
    if not report.good:
        raise typer.Exit(BAD)


def list_faults(json: JsonOption = False) -> None:
    """List all faults."""
    from deltaq_testing.faults.catalogue import CATALOGUE

    if json:
        told = ("name", "what", "virtual", "live", "injectable")
        print_json({"faults": [{name: getattr(row, name) for name in told} for row in CATALOGUE]})
        return
    columns = ("fault", "what happens", "table", "live", "inject")
    print_table("faults", columns, ((row.name, row.what, *_ways(row)) for row in CATALOGUE))


def table(
    names: Annotated[list[str] | None, typer.Argument(help="Faults to inject; all if none is given.")] = None,
    cell: CellOption = "lab",
    robot: MovedOption = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the links' faults; the same seed gives the same run.")
    ] = 0,
    json: JsonOption = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a table for a document.")] = False,
) -> None:
    """Inject faults into a moving robot, one by one; exit status 1 if a limit was passed or it never moved again."""
    from deltaq_testing.faults.catalogue import CATALOGUE, fault_named
    from deltaq_testing.faults.virtual import COLUMNS, run_table, shown
    from deltaq_testing.faults.virtual import markdown as page

    chosen = [fault_named(name) for name in names] if names else CATALOGUE
    with progress_bar("faults") as progress:
        result = run_table(cell, robot, faults=chosen, seed=seed, on_row=progress)
    if json:
        print_json(result.model_dump(mode="json") | {"good": result.good})
    elif markdown:
        typer.echo(page(result))
    else:
        title = f"faults of {result.robot} in cell {result.cell}, in virtual time"
        print_table(title, COLUMNS, map(shown, result.rows))
    if not result.good:
        raise typer.Exit(BAD)


def inject(
    name: Annotated[str, typer.Argument(help="A fault that `deltaq fault list` shows as injectable.")],
    robot: RobotOption,
    cell: CellOption = "lab",
    for_s: Annotated[
        float, typer.Option(min=0.0, help="Duration of a fault that does not end by itself.")
    ] = 1.0,
    json: JsonOption = False,
) -> None:
    """Inject a fault into a running emulated cell, through the panel of the robot's emulated controller."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.cell_connection import known_robot
    from deltaq_testing.faults.catalogue import fault_named
    from deltaq_testing.faults.panel import inject as run

    description = load_cell(cell)
    known_robot(description, robot)
    result = run(fault_named(name), description, robot, for_s)
    if json:
        print_json(result.model_dump(mode="json"))
        return
    reason = f" ({result.reason})" if result.reason else ""
    message = f"; on the pendant: {result.krc_message}" if result.krc_message else ""
    typer.echo(f"{name}: {robot} is {result.phase}{reason}, its controller: {result.krc_state}{message}")


def _ways(row: Fault) -> tuple[str, ...]:
    return tuple("yes" if way else "-" for way in (row.virtual, row.live, row.injectable))
