"""`deltaq advise`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.options import (
    CellOption,
    CriterionOption,
    HandsMayLeaveOption,
    JsonOption,
    TaskOption,
    TradeOffOption,
    UrlOption,
    task_of,
    two_criteria,
)
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from deltaq_controllers.advisor.advisor import Option
    from deltaq_deploy.command.advice import Advice

NUMBERS_OF_A_POSE = 6


def advise(
    cell: CellOption = "dawm",
    url: UrlOption = None,
    robot: Annotated[str, typer.Option(help="Robot to advise; by default the first redundant one.")] = "",
    hand: Annotated[
        list[str] | None,
        typer.Option(
            help="Pose of a hand, NAME=X,Y,Z,ROLL,PITCH,YAW in m and deg; by default its present pose."
        ),
    ] = None,
    options: Annotated[int, typer.Option(min=1, max=50, help="Largest number of options.")] = 5,
    method: Annotated[
        str, typer.Option(help="Search method: annealing, shotgun, genetic, monte-carlo or brute-force.")
    ] = "annealing",
    task: TaskOption = "",
    criterion: CriterionOption = None,
    trade_off: TradeOffOption = "",
    hands_may_leave: HandsMayLeaveOption = False,
    effort: Annotated[
        float,
        typer.Option(
            min=0.1, max=100, help="Length of the search, as a factor; 1 suits an operator who waits."
        ),
    ] = 1.0,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the search; the same seed gives the same options.")
    ] = 0,
    offline: Annotated[
        bool, typer.Option("--offline", help="Start from the robot's home, without a running cell.")
    ] = False,
    execute: Annotated[
        int, typer.Option(min=0, help="Drive to the option of this rank, through the gate.")
    ] = 0,
    json: JsonOption = False,
) -> None:
    """Rank configurations that hold the hands at their present or at given poses; Ctrl-C ends the search early."""
    from deltaq_controllers.advisor.problem import NotRedundantError
    from deltaq_deploy.command.advice import AdviceRequest, advice
    from deltaq_deploy.command.console import print_json

    if offline and execute:
        raise typer.BadParameter("--execute needs a running cell; leave out --offline")
    if offline and url is not None:
        raise typer.BadParameter("--url is that of a running cell; leave out --offline")
    request = AdviceRequest(
        cell=cell,
        url=url,
        robot=robot,
        hands=dict(_pose(text) for text in hand or []),
        options=options,
        method=method,
        task=task_of(task, criterion),
        effort=effort,
        seed=seed,
        offline=offline,
        execute=execute,
        trade_off=two_criteria(trade_off),
        hands_may_leave=hands_may_leave,
    )
    try:
        with _Watched() as watched:
            found = advice(request, watched.go_on)
    except NotRedundantError as error:
        raise NotRedundantError(f"{error}: give --hands-may-leave") from None
    if json:
        print_json(found.as_dict())
    else:
        _show(found)
    if not found.options or (found.executed is not None and not found.executed.reached):
        raise typer.Exit(BAD)


class _Watched:
    """Shows progress on standard error; the first Ctrl-C ends the search."""

    def __init__(self) -> None:
        self._told_to_end = False

    def __enter__(self) -> _Watched:
        import signal
        import sys

        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        from deltaq_deploy.command.console import console

        output = console(sys.stderr)
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=output, transient=True, disable=not output.is_terminal)
        self._task = self._bar.add_task("searching", total=1.0)
        self._bar.start()
        self._before = signal.signal(signal.SIGINT, self._interrupted)
        return self

    def __exit__(self, *_: object) -> None:
        import signal

        signal.signal(signal.SIGINT, self._before)
        self._bar.stop()

    def _interrupted(self, *_: object) -> None:
        if self._told_to_end:
            raise KeyboardInterrupt
        self._told_to_end = True

    def go_on(self, progress: Any) -> bool:
        """Show the advisor's progress; False once Ctrl-C was pressed."""
        text = f"{progress.doing}, best energy {progress.energy:.4f}, {progress.trials} trials"
        self._bar.update(self._task, completed=progress.done, description=text)
        return not self._told_to_end


def _pose(text: str) -> tuple[str, tuple[float, ...]]:
    name, _, numbers = text.partition("=")
    try:
        values = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        values = ()
    if len(values) != NUMBERS_OF_A_POSE:
        raise typer.BadParameter(f"--hand takes NAME=X,Y,Z,ROLL,PITCH,YAW in m and deg, got {text!r}")
    return name, values


def _show(found: Advice) -> None:
    from deltaq_deploy.command.console import counts, print_table

    names = list(found.weights) if found.trade_off is None else list(found.trade_off)
    columns = ("rank", "energy", *names, "nearest", "nearest limit", "path")
    print_table(
        f"{found.robot}: options by {found.method}, {found.trials} trials in {found.elapsed_s:.2f} s",
        columns,
        (_row(rank, option, names) for rank, option in enumerate(found.options, start=1)),
    )
    if found.options:
        typer.echo(f"energy here: {found.options[0].energy_here:.4f}")
    else:
        typer.echo(
            "no configuration holds the hands there clear of limits and obstacles; move them, or raise --effort"
        )
    if found.word:
        typer.echo(found.word)
    if found.executed is not None:
        there = "at" if found.executed.reached else "stopped on the path to"
        typer.echo(
            f"{found.robot} is {there} option {found.executed.option}; gate: {counts(found.executed.outcomes)}"
        )


def _row(rank: int, option: Option, names: list[str]) -> tuple[str, ...]:
    path = option.no_path if option.path is None else f"{len(option.path)} points"
    if option.hands_move:
        path += ", hands leave and come back" if option.hands_leave else ", hands move"
    costs = (f"{option.costs[name]:.3f}" for name in names)
    near = [f"{1000 * one.distance_m:.0f} mm {' and '.join(one.pair)}" for one in option.nearest.values()]
    limit = f"{option.nearest_limit} {100 * option.limit_share:.0f} %"
    return (
        str(rank),
        f"{option.energy:.4f}",
        *costs,
        "\n".join(near) or "-",
        limit,
        path,
    )
