"""`deltaq fault run` and `deltaq fault search`: scenario files for a controller of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_command.options import JsonOption
from deltaq_launch.exit_status import BAD

if TYPE_CHECKING:
    from deltaq_testing.scenario.run import ScenarioOutcome

SeedOption = Annotated[
    int | None,
    typer.Option(min=0, max=2**32 - 1, help="Seed in place of the file's; the same seed gives the same run."),
]


def run(
    files: Annotated[list[Path], typer.Argument(help="Scenario files.", metavar="FILE...")],
    seed: SeedOption = None,
    junit: Annotated[Path | None, typer.Option(help="JUnit XML file to write.")] = None,
    html: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    json: JsonOption = False,
) -> None:
    """Run scenarios in virtual time: faults for your controller; exit status 1 if an expectation was not met."""
    from deltaq_command.console import print_json, print_table
    from deltaq_testing.scenario.file import load_scenario
    from deltaq_testing.scenario.junit import junit_xml
    from deltaq_testing.scenario.run import Runner
    from deltaq_testing.scenario.write import write_report

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
    to: Annotated[
        Path | None, typer.Option(help="Scenario file to write with the shortest schedule that fails.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Look for faults under which a scenario fails, and shrink them; exit status 1 if there are any."""
    from deltaq_command.console import print_json, print_table
    from deltaq_command.progress import progress_bar
    from deltaq_testing.scenario.file import dumped, load_scenario
    from deltaq_testing.scenario.run import Runner
    from deltaq_testing.scenario.search import shortest_failure
    from deltaq_testing.scenario.write import write_report

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
    if to is not None:
        write_report(to, dumped(outcome.scenario))
    if not json:
        print_table(_title(outcome), ("expected", "met", "found"), _rows(outcome))
        typer.echo("The shortest schedule that was found to fail:")
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
