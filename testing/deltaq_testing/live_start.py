"""Starts a live cell for tests, and ends it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.private_cell import write_private_cell
from deltaq_deploy.launch.services import Role, Service, cell_services
from deltaq_testing.deciding import CellUseError
from deltaq_testing.faults.panel import PanelClient
from deltaq_testing.faults.rsi_cell import load_rsi_cell
from deltaq_testing.live import LiveCell


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
    records = folder / "records"
    records.mkdir()
    services = [_recording(service, records) for service in cell_services(description, str(loaded.file))]
    with ExitStack() as stack:
        # Ctrl-C ends the tests, whose end ends the cell
        launcher = stack.enter_context(Launcher(services, lambda *_: None, signals_raise=True))
        panels = {name: stack.enter_context(PanelClient(description, name)) for name in loaded.model.robots}
        launcher.start()
        live = LiveCell(loaded, robot or next(iter(panels)), launcher, panels, records)
        if not live.recover():
            raise CellUseError("the robots do not get ready; is the machine busy with other work?")
        live.begin()
        stack.callback(live.end_programs)
        yield live


def _recording(service: Service, folder: Path) -> Service:
    if service.role is not Role.EMULATOR:
        return service
    return replace(service, arguments=(*service.arguments, "--records", str(folder)))
