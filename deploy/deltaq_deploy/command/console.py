"""Output of the command: JSON; tables, prefixed logs and progress bars."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from deltaq_deploy.launch.prepare import Needed
    from deltaq_deploy.launch.services import Service


PIPE_WIDTH = 160
"""A pipe has no width of its own; a table may be this wide."""
_COLOURS = ("cyan", "green", "magenta", "yellow", "blue", "bright_red", "bright_cyan", "bright_green")


def console(file: TextIO | None = None) -> Console:
    """A console that leaves text as it is: no guessed highlights, no markup in messages."""
    from rich.console import Console

    return Console(file=file, highlight=False, markup=False, soft_wrap=True)


def print_json(data: object) -> None:
    """One JSON object on one line, on standard output, at once."""
    sys.stdout.write(json.dumps(data) + "\n")
    sys.stdout.flush()


def print_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """A table on standard output; None is shown as a dash."""
    target = console()
    if not target.is_terminal:
        target.width = PIPE_WIDTH
    target.print(table_of(title, columns, rows))


def table_of(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A table; None is shown as a dash."""
    from rich.table import Table

    texts = [["-" if cell is None else str(cell) for cell in row] for row in rows]
    table = Table(title=title, title_justify="left", title_style="bold")
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if all(_is_number(row[number]) for row in texts) else "left")
    for row in texts:
        table.add_row(*row)
    return table


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True


def prefixed_log(target: Console, names: Iterable[str]) -> Callable[[str, str], None]:
    """A function that prints a service's line behind its name, in that service's colour."""
    from rich.text import Text

    names = [*names, "deltaq"]
    width = max(len(name) for name in names)
    colours = {name: _COLOURS[number % len(_COLOURS)] for number, name in enumerate(names)}

    def show(name: str, line: str) -> None:
        target.print(Text.assemble((f"{name:<{width}} │ ", colours.get(name, "white")), line))

    return show


def json_log(services: Iterable[Service]) -> Callable[[str, str], None]:
    """A function that prints a service's line as JSON: unchanged, or inside an object if it is text."""
    from deltaq_protocol.log import json_line, read_json_line

    known = {service.name: service for service in services}

    def show(name: str, line: str) -> None:
        if read_json_line(line) is None:
            service = known.get(name)
            kind, robot = (name, None) if service is None else (str(service.role), service.robot)
            line = json_line(kind, line, robot=robot)
        sys.stdout.write(line + "\n")
        sys.stdout.flush()

    return show


def counts(counters: dict[str, int]) -> str:
    """Counters on one line, those that are zero left out."""
    return ", ".join(f"{name} {value}" for name, value in counters.items() if value) or "none"


def degrees_or_millimetres(value: float, unit: str) -> str:
    """A joint position as text, in degrees or millimetres."""
    import math

    return f"{math.degrees(value):.1f}°" if unit == "rad" else f"{value * 1000:.0f} mm"


def flat(data: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Names and values of a nested map, names joined by dots, numbers to four digits."""
    rows = []
    for key, value in data.items():
        if isinstance(value, dict):
            rows += flat(value, f"{prefix}{key}.")
        else:
            rows.append((prefix + key, f"{value:.4g}" if isinstance(value, float) else str(value)))
    return rows


TOLD_EVERY_S = 10.0
"""Where there is no terminal."""


@contextmanager
def progress_bar(text: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar; it yields a function that takes the steps done and the steps in all.

    Until the first call it shows activity and elapsed time; without a terminal, nothing.
    """
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    output = console(sys.stderr)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=output, transient=True, disable=not output.is_terminal) as progress:
        task = progress.add_task(text, total=None)

        def move(done: int, of: int) -> None:
            progress.update(task, completed=done, total=of)

        yield move


@contextmanager
def shown_compiled_ahead(needed: Needed) -> Iterator[None]:
    """Compile what the block needs before it begins; standard error shows the progress.

    Raises:
        LaunchError: if they cannot be compiled.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from deltaq_deploy.launch.prepare import compiled_ahead

    output = console(sys.stderr)
    columns = (
        TextColumn("compiling"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("functions, {task.description},"),
        TimeElapsedColumn(),
        TextColumn("passed, about"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    progress = Progress(*columns, console=output, transient=True, disable=not output.is_terminal)
    task = progress.add_task("", total=needed.functions, visible=False)
    begun_s, told_s, count = time.monotonic(), 0.0, 0

    def show(function: str) -> None:
        nonlocal told_s, count
        if not count:
            output.print(
                "compiling what is needed, once for this version; a small machine takes up to four minutes"
            )
        count += 1
        of, passed_s = max(needed.functions, count), time.monotonic() - begun_s
        if not output.is_terminal and passed_s - told_s >= TOLD_EVERY_S:
            told_s = passed_s
            left_s = passed_s * (of - count) / count
            output.print(
                f"compiled {count} of about {of} functions in {passed_s:.0f} s; about {left_s:.0f} s are left"
            )
        progress.update(task, description=function, completed=count, total=of, visible=True)

    with ExitStack() as stack:
        with progress:
            stack.enter_context(compiled_ahead(needed, output.print, show))
        yield
