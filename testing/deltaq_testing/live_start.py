"""Starts a live cell for tests, and ends it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services
from deltaq_testing.faults.controller import CellUseError
from deltaq_testing.faults.panel import PanelClient, load_rsi_cell
from deltaq_testing.live import LiveCell
from deltaq_testing.private_cell import write_private_cell


@contextmanager
def live_cell(folder: Path, cell: str | Path = "lab", robot: str | None = None) -> Iterator[LiveCell]:
    """Start a cell of real processes on free ports; everything is ended after the block.

    Args:
        folder: for its file and records.
        cell: name or file of a cell whose robots are driven over RSI.
        robot: the one under test; None for the first.

    Raises:
        UnknownFaultError: the cell has no such robot, or one without a KRC.
        LaunchError: a process does not come up.
    """
    load_rsi_cell(cell, robot)
    loaded = load_rsi_cell(write_private_cell(folder, cell))
    description = loaded.model.description
    records = {name: folder / f"{name}.csv" for name in loaded.model.robots}
    services = [recorded(service, records) for service in cell_services(description, str(loaded.file))]
    with ExitStack() as stack:
        # Ctrl-C ends the tests, whose end ends the cell
        launcher = stack.enter_context(Launcher(services, lambda *_: None, signals_raise=True))
        panels = {name: stack.enter_context(PanelClient(description, name)) for name in loaded.model.robots}
        launcher.start()
        live = LiveCell(loaded, robot or next(iter(panels)), launcher, panels, records)
        if not live.recover():
            raise CellUseError("the robots did not become ready; is the machine busy with other programs?")
        live.begin()
        stack.callback(live.end_programs)
        yield live


def recorded(service: Service, records: dict[str, Path]) -> Service:
    """The service, an emulated controller with the record that it is to write."""
    if service.role is not Role.EMULATOR or service.robot is None:
        return service
    return replace(service, arguments=(*service.arguments, "--record", str(records[service.robot])))


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
        """Enter; no cell is started yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the cell that runs."""
        self._running.close()

    def get(self, cell: str, robot: str | None) -> LiveCell:
        """A cell with ready robots, the one under test at home; raises as `live_cell` does."""
        if self._cell is not None and self._asked == (cell, robot) and self._cell.renew():
            return self._cell
        self._running.close()
        self._cell, self._asked = None, None
        self._cell = self._running.enter_context(live_cell(self._new_folder(), cell, robot))
        self._asked = cell, robot
        return self._cell
