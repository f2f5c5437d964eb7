"""Progress on standard error, if it is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deltaq_launch.prepare import Needed


@contextmanager
def progress_bar(text: str) -> Iterator[Callable[[int, int], None]]:
    """A bar that is moved by calling what it yields with the steps done and the steps in all.

    Until the first call it shows activity and elapsed time; without a terminal, nothing.
    """
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from deltaq_command.console import console

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
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from deltaq_command.console import console
    from deltaq_launch.prepare import compiled_ahead

    output = console(sys.stderr)
    columns = (SpinnerColumn(), TextColumn("compiling {task.description}"), TimeElapsedColumn())
    progress = Progress(*columns, console=output, transient=True, disable=not output.is_terminal)
    task = progress.add_task("", total=None, visible=False)

    def show(function: str) -> None:
        if not progress.tasks[task].visible:
            output.print(
                "compiling the gate and what else is compiled; only the first start does, for up to four minutes"
            )
        progress.update(task, description=function, visible=True)

    with ExitStack() as stack:
        with progress:
            stack.enter_context(compiled_ahead(needed, output.print, show))
        yield
