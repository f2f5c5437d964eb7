"""The live cell of a session of tests: made ready again between tests, and started anew where it cannot be."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from deltaq_testing.live import LiveCell
from deltaq_testing.live_start import live_cell


class LiveCells:
    """A context manager, which ends the cell that runs.

    Args:
        new_folder: makes a folder for the files of a cell.
    """

    def __init__(self, new_folder: Callable[[], Path]) -> None:
        self._new_folder = new_folder
        self._running = ExitStack()
        self._asked: tuple[str, str | None] | None = None
        self._cell: LiveCell | None = None

    def __enter__(self) -> Self:
        """Nothing runs before a cell is asked for."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the cell that runs."""
        self._running.close()

    def get(self, cell: str, robot: str | None) -> LiveCell:
        """A cell whose robots are ready, the one under test at home; raises as `live_cell` does."""
        if self._cell is not None and self._asked == (cell, robot) and self._cell.renew():
            return self._cell
        self._running.close()
        self._cell, self._asked = None, None
        self._cell = self._running.enter_context(live_cell(self._new_folder(), cell, robot))
        self._asked = cell, robot
        return self._cell
