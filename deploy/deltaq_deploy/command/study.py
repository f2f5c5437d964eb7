"""Verbs that run experiments and benchmarks."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from deltaq_controllers.camera import FOLLOWS
from deltaq_deploy.command.options import CellOption, JsonOption
from deltaq_deploy.launch.exit_status import BAD


class Experiment(StrEnum):
    """The experiments, each a module of `deltaq_experiments`."""

    APPROACH = "approach"
    TRACKING = "tracking"
    ZOOM = "zoom"
    COLLISION = "collision"
    ATTACK = "attack"


CONTROLLERS = (
    "paper, predictive, qp, clear-view, escape, a printed variant (printed, "
    "printed-decay, …), or package.module:function."
)


def experiment(
    name: Annotated[Experiment, typer.Argument(help="Experiment to run.")],
    cell: CellOption = "lab",
    controller: Annotated[str, typer.Option(help=f"Who moves the camera: {CONTROLLERS}")] = FOLLOWS,
    robot: Annotated[
        str | None, typer.Option(help="Robot with the camera (default: the cell's first).", metavar="ROBOT")
    ] = None,
    leader: Annotated[
        str | None,
        typer.Option(help="Robot that is watched (default: the first other one).", metavar="ROBOT"),
    ] = None,
    leader_speed_m_s: Annotated[
        float, typer.Option(min=0.0, help="Speed that the leader's tool is asked for.")
    ] = 0.25,
    stick_m_s2: Annotated[
        float, typer.Option(min=0.1, help="Largest acceleration that the leader's tool is asked for.")
    ] = 2.0,
    latency_s: Annotated[
        float, typer.Option(min=0.0, help="Delay of the leader's states, on top of drives and cycles.")
    ] = 0.0,
    duration_s: Annotated[
        float | None,
        typer.Option(
            min=1.0, help="Length of the run, in the cell's time; by default 40, and 5 for each approach."
        ),
    ] = None,
    settle_s: Annotated[
        float, typer.Option(min=0.0, help="Duration of the start-up, which the figures leave out.")
    ] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the run; the same seed gives the same run.")] = 0,
    target: Annotated[
        str, typer.Option(help="What a collision aims at: lens, wrist, elbow or all.")
    ] = "lens",
    aim_offset_m: Annotated[
        tuple[float, float, float],
        typer.Option(help="Point of the leader's tool to look at, in the tool's frame."),
    ] = (0.0, 0.0, 0.0),
    no_gate: Annotated[
        bool,
        typer.Option(
            "--no-gate", help="Run a collision without the gate, to show what the follower alone prevents."
        ),
    ] = False,
    live: Annotated[bool, typer.Option("--live", help="Run over real processes, zenoh and UDP.")] = False,
    json: JsonOption = False,
    figure: Annotated[Path | None, typer.Option(help="Picture to write, laid out as in the paper.")] = None,
    record: Annotated[
        Path | None, typer.Option(help="MCAP file to record to, for `deltaq replay`; it must not exist.")
    ] = None,
) -> None:
    """Run an experiment in virtual time, or live, and report figures; exit status 1 on a violation."""
    import importlib

    from deltaq_deploy.command.console import print_json
    from deltaq_deploy.command.progress import progress_bar, shown_compiled_ahead
    from deltaq_deploy.launch.prepare import Needed
    from deltaq_experiments.figures import draw
    from deltaq_services.recorder.writer import RecordingError

    if name is Experiment.ATTACK:
        if live or figure is not None or record is not None:
            raise typer.BadParameter(
                "attack runs in virtual time, and takes --seed, --duration-s and --json alone"
            )
        _attack(cell, seed, duration_s or 60.0, json)
        return
    if no_gate and name is not Experiment.COLLISION:
        raise typer.BadParameter(f"--no-gate goes with collision; {name.value} runs through the gate")
    if record is not None and record.exists():
        raise RecordingError(f"{record} exists already; a recording is never overwritten, name another file")
    with shown_compiled_ahead(Needed([controller])):
        # imported here, since these modules search for their machine code on import
        from deltaq_experiments.options import Options

        options = Options(
            cell=cell,
            controller=controller,
            robot=robot,
            leader=leader,
            leader_speed_m_s=leader_speed_m_s,
            stick_m_s2=stick_m_s2,
            latency_s=latency_s,
            duration_s=duration_s,
            seed=seed,
            settle_s=settle_s,
            live=live,
            target=target,
            aim_offset_m=aim_offset_m,
            gated=not no_gate,
            record=record,
        )
        module = importlib.import_module(f"deltaq_experiments.{name.value}")
        length = f"{name.value}, {duration_s or module.DURATION_S:g} s"
        with progress_bar(f"{length} live" if live else length):
            outcome = module.run(options)
    report = outcome.report.model_dump(mode="json")
    if figure is not None:
        reached = report["leader_reached_m_s"]
        leads = f"{leader_speed_m_s:g} m/s asked, mean {reached['mean']:.2f}, peak {reached['peak']:.2f}"
        title = f"{name.value}, controller {controller}, leader: {leads}, seed {seed}"
        draw(outcome.panels, title, figure)
    if json:
        print_json(report)
    else:
        _show(report)
    if any(report["limits"].values()):
        raise typer.Exit(BAD)


def _attack(cell: str, seed: int, duration_s: float, json: bool) -> None:
    from deltaq_deploy.command.console import print_json
    from deltaq_deploy.command.progress import progress_bar
    from deltaq_testing.attack import run

    with progress_bar(f"attack, {duration_s:g} s") as move:
        outcome = run(cell, seed=seed, duration_s=duration_s, on_cycle=move)
    report = outcome.model_dump(mode="json")
    if json:
        print_json(report)
    else:
        _show(report | {"controller": "adversaries"})
    if outcome.violations or any(report["limits"].values()):
        raise typer.Exit(BAD)


def _show(report: dict[str, Any]) -> None:
    from deltaq_deploy.command.console import flat, print_table

    print_table(
        f"{report['experiment']} with the {report['controller']} controller", ("what", "value"), flat(report)
    )


def peg_and_valve(
    cell: CellOption = "lab",
    robot: Annotated[
        str | None, typer.Option(help="A redundant robot with one hand.", show_default="the cell's first")
    ] = None,
    mode: Annotated[list[str] | None, typer.Option(help="Only this mode; repeatable.")] = None,
    seeds: Annotated[
        int,
        typer.Option(
            min=1,
            max=1000,
            help="Runs of each mode; the seed of a run places hole and valve and draws the operator.",
        ),
    ] = 10,
    json: JsonOption = False,
) -> None:
    """Put in a peg and turn a valve in each mode of teleoperation, in virtual time; report time and error."""
    from deltaq_deploy.command.console import print_json, print_table
    from deltaq_deploy.command.progress import progress_bar
    from deltaq_experiments.peg_and_valve import OFF_MM, OPERATORS, TILT_DEG, robot_for_the_task, run
    from deltaq_experiments.peg_and_valve_summary import FIGURES, by_mode, distributions

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
