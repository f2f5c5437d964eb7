"""A cell of real processes with a robot that moves, and the record that every emulated controller keeps."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltaq_deploy.launcher import Launcher
from deltaq_deploy.services import Role, Service, cell_services, recorder
from deltaq_emulator.states import KrcState
from deltaq_experiments.faults.catalogue import Process
from deltaq_experiments.faults.loaded import LoadedCell
from deltaq_experiments.faults.panel import PanelClient
from deltaq_experiments.faults.placed import Place, PlacedRelay, placed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MovingCell:
    """A cell of real processes whose robot is moved.

    Attributes:
        launcher: of its services.
        panel: of the robot's emulated controller.
        records: what every emulated controller keeps.
        relay: in the wire that is to be impaired, if one is.
    """

    launcher: Launcher
    panel: PanelClient
    records: dict[str, Path]
    relay: PlacedRelay | None


@contextmanager
def moving_cell(
    loaded: LoadedCell, robot: str, place: Place | None = None, *, recorded: bool = False, seed: int = 0
) -> Iterator[MovingCell]:
    """Start the cell's services and a controller that moves the robot.

    Args:
        loaded: the cell; nobody else may run it.
        robot: the one that moves.
        place: where a relay shall stand.
        recorded: whether a recorder shall run.
        seed: of the relay's random numbers.
    """
    description = loaded.model.description
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        records = {name: folder / f"{name}.csv" for name in loaded.model.robots}
        services = [_recorded(service, records) for service in cell_services(description, str(loaded.file))]
        port, relay = description.tcp_port, None
        if place is not None:
            relay = stack.enter_context(placed(place, description, robot, seed))
            services = relay.told(services, loaded, robot, folder)
            port = relay.controller_port
        home = loaded.model.robots[robot].home[0]
        arguments = ("-m", "deltaq_experiments.faults.mover", str(port), robot, f"{home}")
        services.append(Service(Process.CONTROLLER, Role.LEADER, arguments, needs=("hli",)))
        if recorded:
            services.append(recorder(str(loaded.file), str(folder / "run.mcap")))
        launcher = stack.enter_context(Launcher(services, lambda *_: None))
        panel = stack.enter_context(PanelClient(description, robot))
        launcher.start()
        yield MovingCell(launcher, panel, records, relay)


def _recorded(service: Service, records: dict[str, Path]) -> Service:
    if service.role is not Role.EMULATOR or service.robot is None:
        return service
    return replace(service, arguments=(*service.arguments, "--record", str(records[service.robot])))


def rows_of(record: Path) -> Array:
    """Whole rows of a record that is being written: cycle, q (n), setpoint (n), 1 while RSI runs."""
    text = record.read_text(encoding="utf-8")
    lines = text[: text.rfind("\n")].splitlines()[1:]
    rows = []
    for line in lines:
        cycle, _, *numbers, state = line.split(",")
        rows.append([float(cycle), *map(float, numbers), float(state == KrcState.RSI_RUNNING)])
    return np.array(rows)
