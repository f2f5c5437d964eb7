"""Progress on standard error, if it is a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deltaq_deploy.launch.prepare import Needed


TOLD_EVERY_S = 10.0
"""Where there is no terminal."""


@contextmanager
def progress_bar(text: str) -> Iterator[Callable[[int, int], None]]:
    """A bar that is moved by calling what it yields with the steps done and the steps in all.

    Until the first call it shows activity and elapsed time; without a terminal, nothing.
    """
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from deltaq_deploy.command.console import console

    output = console(sys.stderr)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=output, transient=True, disable=not output.is_terminal) as progress:
        task = progress.add_task(text, total=None)

        def move(done: int, of: int) -> None:
            progress.update(task, completed=done, total=of)

        yield move


@contextmanager
def shown_compiled_ahead(needed: Needed) -> Iterator[None]:
    """Compile what is needed before the block; standard error shows a line, and what is compiled now.

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

    from deltaq_deploy.command.console import console
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
