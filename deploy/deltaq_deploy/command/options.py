"""Options that several verbs share."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from deltaq_controllers.task import Task

CellOption = Annotated[
    str, typer.Option("--cell", help="Name of a shipped cell or path of a YAML file.", show_default=True)
]
UrlOption = Annotated[
    str | None,
    typer.Option(
        "--url",
        metavar="tcp/HOST:PORT",
        help="Address of the cell's HLI; it replaces --cell, and no cell file is needed.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
RobotOption = Annotated[str, typer.Option("--robot", help="Name of a robot of the cell.")]
ControllerOption = Annotated[
    str,
    typer.Option(
        help="Camera controller: qp, paper, predictive, clear-view, escape, or your own as package.module:function."
    ),
]
CriterionOption = Annotated[
    list[str] | None,
    typer.Option(
        "--criterion",
        "--weight",
        metavar="NAME=WEIGHT",
        help="A criterion and its weight, e.g. clearance=1, in place of the default ones; repeatable.",
    ),
]
TaskOption = Annotated[
    str,
    typer.Option(
        "--task",
        metavar="FILE",
        help="A task in a YAML file, or one that comes with deltaq: gauge, lever, peg, saw_cut, valve.",
    ),
]
TradeOffOption = Annotated[
    str,
    typer.Option(
        "--trade-off",
        help="Two criteria, A,B: show options on the Pareto front of both.",
    ),
]
HandsMayLeaveOption = Annotated[
    bool,
    typer.Option(
        "--hands-may-leave",
        help="Also offer options on whose path the hands leave their poses and come back.",
    ),
]
ConsoleOption = Annotated[
    bool, typer.Option("--console/--no-console", help="Start the operator's console, for a browser.")
]


def _operators_token(given: str | None) -> str | None:
    from deltaq_protocol.given_token import OPERATOR_TOKEN, given_token

    return given or given_token(OPERATOR_TOKEN)


TokenOption = Annotated[
    str | None,
    typer.Option(
        callback=_operators_token,
        help="The operator's token, if the HLI was given one; by default that of DELTAQ_OPERATOR_TOKEN, "
        "or of the file that DELTAQ_OPERATOR_TOKEN_FILE names.",
    ),
]


def weights_of(texts: Sequence[str] | None, option: str) -> dict[str, float] | None:
    """Criterion to weight, from texts such as `travel=1`; None for none."""
    return dict(_weight(text, option) for text in texts or ()) or None


def task_of(name: str, criteria: Sequence[str] | None) -> "Task":
    """The task of `--task`, with the weights of `--criterion` if there are any.

    Raises:
        CellError: there is no such task, or its file has errors.
    """
    from deltaq_controllers.task import NO_TASK, load_task

    task, weights = load_task(name) if name else NO_TASK, weights_of(criteria, "--criterion")
    return task if weights is None else task.model_copy(update={"weights": weights})


def two_criteria(text: str) -> tuple[str, str] | None:
    """Names of two criteria to trade off, from a text such as `travel,compliance`; None for none."""
    if not text:
        return None
    first, _, second = text.partition(",")
    if not first or not second or "," in second or first == second:
        raise typer.BadParameter(f"--trade-off takes the names of two criteria, A,B, got {text!r}")
    return first, second


def _weight(text: str, option: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError:
        raise typer.BadParameter(f"{option} takes NAME=NUMBER, got {text!r}") from None
