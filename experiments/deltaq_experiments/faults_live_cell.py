"""A cell of real processes with a robot that moves, and the record that every emulated controller keeps."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltaq_deploy.launcher import Launcher
from deltaq_deploy.services import Role, Service, cell_services
from deltaq_emulator.states import KrcState
from deltaq_experiments.faults import Process
from deltaq_experiments.faults_loaded import LoadedCell
from deltaq_experiments.faults_panel import PanelClient

Array = NDArray[np.float64]


@contextmanager
def moving_cell(loaded: LoadedCell, robot: str) -> Iterator[tuple[Launcher, PanelClient, dict[str, Path]]]:
    """The cell's services, a controller that moves the robot, its panel, and every robot's record."""
    description = loaded.model.description
    with tempfile.TemporaryDirectory() as folder:
        records = {name: Path(folder, f"{name}.csv") for name in loaded.model.robots}
        services = [_recorded(service, records) for service in cell_services(description, str(loaded.file))]
        home = loaded.model.robots[robot].home[0]
        told_mover = (str(description.tcp_port), robot, f"{home}")
        arguments = ("-m", "deltaq_experiments.faults_mover", *told_mover)
        mover = Service(Process.CONTROLLER, Role.LEADER, arguments, needs=("hli",))
        launcher = Launcher([*services, mover], lambda *_: None)
        with launcher, PanelClient(description, robot) as panel:
            launcher.start()
            yield launcher, panel, records


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
