"""Verbs that run experiments and benchmarks."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_controllers.camera import FOLLOWS
from deltaq_deploy.command.console import (
    console,
    flat,
    print_json,
    print_table,
    progress_bar,
    shown_compiled_ahead,
)
from deltaq_deploy.command.options import CellOption, ControllerOption, JsonOption
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from deltaq_experiments.bench.live import LiveOptions, LiveRun
    from deltaq_experiments.bench.table import BenchTable


class Experiment(StrEnum):
    """The experiments, each a module of `deltaq_experiments`."""

    APPROACH = "approach"
    TRACKING = "tracking"
    ZOOM = "zoom"
    COLLISION = "collision"
    ATTACK = "attack"
    PEG_AND_VALVE = "peg-and-valve"


_TAKES = {
    Experiment.ATTACK: "--seed, --duration-s",
    Experiment.PEG_AND_VALVE: "--robot, --mode, --seeds",
}
"""Options of the experiments that no camera controller takes part in."""

LatencyOption = Annotated[
    float, typer.Option(min=0.0, help="Delay of the leader's states, on top of drives and cycles.")
]
LengthOption = Annotated[
    float | None,
    typer.Option(
        min=1.0, help="Length of the run, in the cell's time; by default 40, and 5 for each approach."
    ),
]
SettleOption = Annotated[
    float, typer.Option(min=0.0, help="Duration of the start-up, which the figures leave out.")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of the run; the same seed gives the same run.")]
TargetOption = Annotated[str, typer.Option(help="What a collision aims at: lens, wrist, elbow or all.")]
AimOption = Annotated[
    tuple[float, float, float] | None,
    typer.Option(
        help="Point of the leader's tool to look at, in the tool's frame.",
        show_default="0 0 0.04, before the fingers",
    ),
]
NoGateOption = Annotated[
    bool,
    typer.Option(
        "--no-gate", help="Run a collision without the gate, to show the effect of the follower alone."
    ),
]
_FOLLOWING = typer.Option(
    help="Robot with the camera (default: the cell's first); of peg-and-valve the robot that works.",
    metavar="ROBOT",
)
_WATCHED = typer.Option(help="Robot that is watched (default: the first other one).", metavar="ROBOT")
ModesOption = Annotated[
    list[str] | None,
    typer.Option("--mode", help="peg-and-valve: only this mode of teleoperation; repeatable."),
]
SeedsOption = Annotated[
    int,
    typer.Option(
        min=1,
        max=1000,
        help="peg-and-valve: runs of each mode; the seed of a run places hole and valve and draws the operator.",
    ),
]
RecordOption = Annotated[
    Path | None,
    typer.Option(help="MCAP file to record to, for `deltaq recording replay`; it must not exist."),
]


def experiment(
    name: Annotated[Experiment, typer.Argument(help="Experiment to run.")],
    cell: CellOption = "lab",
    controller: ControllerOption = FOLLOWS,
    robot: Annotated[str | None, _FOLLOWING] = None,
    leader: Annotated[str | None, _WATCHED] = None,
    leader_speed_m_s: Annotated[
        float, typer.Option(min=0.0, help="Requested speed of the leader's tool.")
    ] = 0.25,
    stick_m_s2: Annotated[
        float, typer.Option(min=0.1, help="Largest requested acceleration of the leader's tool.")
    ] = 2.0,
    latency_s: LatencyOption = 0.0,
    duration_s: LengthOption = None,
    settle_s: SettleOption = 5.0,
    seed: SeedOption = 0,
    target: TargetOption = "lens",
    aim_offset_m: AimOption = None,
    no_gate: NoGateOption = False,
    live: Annotated[bool, typer.Option("--live", help="Run over real processes, zenoh and UDP.")] = False,
    json: JsonOption = False,
    figure: Annotated[Path | None, typer.Option(help="Picture to write, laid out as in the paper.")] = None,
    record: RecordOption = None,
    mode: ModesOption = None,
    seeds: SeedsOption = 10,
) -> None:
    """Run an experiment in virtual time, or live, and report figures; exit status 1 on a violation.

    attack drives both robots by adversaries, over links that lose and delay, and has an independent checker judge the
    gate. peg-and-valve puts in a peg and turns a valve in each mode of teleoperation, and reports time and error.
    """
    from deltaq_services.recorder.writer import RecordingError

    takes = _TAKES.get(name)
    if takes is not None and (live or figure is not None or record is not None):
        raise typer.BadParameter(f"{name.value} runs in virtual time, and takes only {takes} and --json")
    if name is Experiment.ATTACK:
        _attack(cell, seed, duration_s or 60.0, json)
        return
    if name is Experiment.PEG_AND_VALVE:
        _peg_and_valve(cell, robot, mode, seeds, json)
        return
    if no_gate and name is not Experiment.COLLISION:
        raise typer.BadParameter(f"--no-gate goes with collision; {name.value} runs through the gate")
    if record is not None and record.exists():
        raise RecordingError(f"{record} exists already; a recording is never overwritten, name another file")
    options = {
        "cell": cell,
        "controller": controller,
        "robot": robot,
        "leader": leader,
        "leader_speed_m_s": leader_speed_m_s,
        "stick_m_s2": stick_m_s2,
        "latency_s": latency_s,
        "duration_s": duration_s,
        "seed": seed,
        "settle_s": settle_s,
        "live": live,
        "target": target,
        **({} if aim_offset_m is None else {"aim_offset_m": aim_offset_m}),
        "gated": not no_gate,
        "record": record,
    }
    report = _run(name, options, figure)
    _told(report, json)
    if any(report["limits"].values()):
        raise typer.Exit(BAD)


def _told(report: dict[str, Any], json: bool, controller: str = "adversaries") -> None:
    """Print a report as JSON, or as a table."""
    if json:
        print_json(report)
    else:
        title = f"{report['experiment']} with the {report.get('controller', controller)} controller"
        print_table(title, ("what", "value"), flat(report))


def _run(name: Experiment, asked: dict[str, Any], figure: Path | None) -> dict[str, Any]:
    """Run an experiment with the options asked for, draw its figure, and return its report."""
    import importlib

    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.figures import draw

    with shown_compiled_ahead(Needed([asked["controller"]])):
        # imported here, since these modules search for their machine code on import
        from deltaq_experiments.options import Options

        options = Options(**asked)
        module = importlib.import_module(f"deltaq_experiments.{name.value}")
        length = f"{name.value}, {options.duration_s or module.DURATION_S:g} s"
        with progress_bar(f"{length} live" if options.live else length):
            outcome = module.run(options)
    report: dict[str, Any] = outcome.report.model_dump(mode="json")
    if figure is not None:
        reached = report["leader_reached_m_s"]
        leads = (
            f"{options.leader_speed_m_s:g} m/s asked, mean {reached['mean']:.2f}, peak {reached['peak']:.2f}"
        )
        title = f"{name.value}, controller {options.controller}, leader: {leads}, seed {options.seed}"
        draw(outcome.panels, title, figure)
    return report


def _attack(cell: str, seed: int, duration_s: float, json: bool) -> None:
    from deltaq_testing.attack import run

    with progress_bar(f"attack, {duration_s:g} s") as move:
        outcome = run(cell, seed=seed, duration_s=duration_s, on_cycle=move)
    report = outcome.model_dump(mode="json")
    _told(report, json)
    if outcome.violations or any(report["limits"].values()):
        raise typer.Exit(BAD)


def _peg_and_valve(cell: str, robot: str | None, mode: list[str] | None, seeds: int, json: bool) -> None:
    from deltaq_experiments.peg_and_valve import (
        FIGURES,
        OFF_MM,
        OPERATORS,
        TILT_DEG,
        by_mode,
        distributions,
        robot_for_the_task,
        run,
    )

    robot = robot or robot_for_the_task(cell)
    with progress_bar("peg and valve") as move:
        runs = run(cell, robot, mode or tuple(OPERATORS), range(seeds), move)
    if json:
        print_json(
            {
                "robot": robot,
                "tolerance": {"off_mm": OFF_MM, "tilt_deg": TILT_DEG},
                "modes": distributions(runs),
                "runs": [one.model_dump(mode="json") for one in runs],
            }
        )
    else:
        columns = ("mode", "runs, done", *(figure.name for figure in FIGURES))
        rows = [
            (
                name,
                f"{len(ours)}, {sum(not one.undone for one in ours)}",
                *(figure.cell(ours) for figure in FIGURES),
            )
            for name, ours in by_mode(runs).items()
        ]
        title = f"peg and valve with {robot}, seeds 0 to {seeds - 1}: median; worst (its seed)"
        print_table(title, columns, rows)
        for one in runs:
            if one.undone:
                typer.echo(f"{one.mode}, seed {one.seed}: {one.undone}")
    if any(one.undone for one in runs):
        raise typer.Exit(BAD)


def bench(
    context: typer.Context,
    cell: CellOption = "lab",
    cycles: Annotated[int, typer.Option(min=10, help="Cycles of tracking that are timed.")] = 400,
    live: Annotated[
        bool, typer.Option("--live", help="Run the cell, and time each increment on its way through it.")
    ] = False,
    follower: Annotated[str, typer.Option(help="Live: the follower's camera controller.")] = FOLLOWS,
    duration_s: Annotated[float, typer.Option(min=0.5, help="Live: duration of the measurement.")] = 60.0,
    warm_up_s: Annotated[float, typer.Option(min=0.0, help="Live: time before the measurement.")] = 10.0,
    runs: Annotated[int, typer.Option(min=1, help="Live: number of runs; each is reported.")] = 1,
    json: JsonOption = False,
) -> None:
    """Measure against references in the same run; exit status 1 if a bound is not kept."""
    if context.invoked_subcommand is not None:
        return
    if live:
        from deltaq_experiments.bench.live import LiveOptions

        options = LiveOptions(cell, follower, warm_up_s, duration_s)
        good = _live(options, runs, json)
    else:
        good = _alone(cell, cycles, json)
    if not good:
        raise typer.Exit(BAD)


def _alone(cell: str, cycles: int, json: bool) -> bool:
    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.bench.decisions import run

    with shown_compiled_ahead(Needed()), progress_bar("measuring") as move:
        table = run(cell, cycles, move)
    if json:
        print_json(table.model_dump(mode="json") | {"good": table.good})
    else:
        show(table)
    return table.good


def show(table: BenchTable) -> None:
    """The rows as people read them."""
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
    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.bench.live import BARE_S, run_once

    output = console(sys.stderr)
    told: list[LiveRun] = []
    length_s = options.warm_up_s + options.duration_s + BARE_S
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
    title = f"run {number}: processor time and wake-ups of a cycle"
    bare = f"run {number}: the same messages in bare Python"
    for name, used, woken in (
        (title, spent, run.wakeups),
        (bare, list(run.bare.processor_us.items()), run.bare.wakeups),
    ):
        costs = [(process, f"{us:.0f}", _text(woken[process], 1)) for process, us in used]
        print_table(name, ("process", "µs", "wake-ups"), costs)
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
    print_table(f"run {number}: figures", ("what", "here", "reference", "ratio", "bound", ""), figures)
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


def filters(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FILTER",
            help="none, gate, or your own as FILE.py:NAME or package.module:NAME.",
            show_default="none and gate",
        ),
    ] = None,
    scenes: Annotated[int, typer.Option(min=1, help="Number of scenes, drawn from the seed.")] = 3,
    cycles: Annotated[int, typer.Option(min=10, help="Cycles of each adversary.")] = 500,
    seed: SeedOption = 0,
    ideal_drives: Annotated[
        bool, typer.Option("--ideal-drives", help="Drives follow at once, without limits of acceleration.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Compare filters between a program and an arm: contacts, false holds, speed, time.

    A filter is a function (q, dq) -> dq: the arm is at q and is asked to move by dq in this cycle, in rad; the
    function returns what is sent. Or a class: NAME(scene) makes a filter that knows scene.urdf, scene.obstacles,
    scene.cycle_s and the limits; its method start(q), if it has one, is called before each trial.

    The arm is a KR 16 among boxes. Adversaries ask for the fastest motion, and straight paths pass near bodies. coal
    judges each setpoint on the meshes, independently of the gate.
    """
    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.bench.filter_scenes import ROBOT, drawn_scene
    from deltaq_experiments.bench.filters import FILTERS, FilterRow, compare, named

    found = {name: named(name) for name in names or FILTERS}
    rows = {name: FilterRow() for name in found}
    with shown_compiled_ahead(Needed()), progress_bar("comparing") as move:
        for number in range(seed, seed + scenes):
            done = compare(found, drawn_scene(number), rows, cycles, number, ideal_drives)
            for count, _ in enumerate(done, start=1 + (number - seed) * len(found)):
                move(count, scenes * len(found))
    figures = {name: row.figures() for name, row in rows.items()}
    if json:
        told = {
            "robot": ROBOT,
            "scenes": scenes,
            "cycles": cycles,
            "seed": seed,
            "ideal_drives": ideal_drives,
        }
        print_json(told | {"filters": figures})
    else:
        columns = (
            "trials",
            "contacts",
            "penetration mm",
            "false holds %",
            "speed kept %",
            "p50 ms",
            "p99 ms",
        )
        title = f"{ROBOT} in {scenes} scenes, {'ideal drives' if ideal_drives else 'drives with limits'}"
        print_table(title, ("filter", *columns), [(name, *each.values()) for name, each in figures.items()])
