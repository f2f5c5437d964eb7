"""A cell of real processes with a robot that moves, and the record that every emulated controller keeps."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services, recorder
from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array
from deltaq_testing.faults.actions import (
    BeginInThePast,
    FillDisk,
    Freeze,
    Kill,
    SetWallClock,
    StepClock,
)
from deltaq_testing.faults.catalogue import Fault
from deltaq_testing.faults.clocks import SettableClocks
from deltaq_testing.faults.panel import PanelClient
from deltaq_testing.faults.relay_placement import PlacedRelay, RelayPlacement, placed
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process


@dataclass(frozen=True)
class MovingCell:
    """A cell of real processes whose robot is moved.

    Attributes:
        launcher: of its services.
        panel: of the robot's emulated controller.
        records: what every emulated controller keeps.
        relay: in the wire that is to be impaired, if one is.
        clocks: of its processes, where they can be set.
    """

    launcher: Launcher
    panel: PanelClient
    records: dict[str, Path]
    relay: PlacedRelay | None
    clocks: SettableClocks | None


@dataclass(frozen=True)
class Needs:
    """What a fault needs of a cell of real processes.

    Attributes:
        place: where a relay has to stand.
        recorder: a recorder has to run.
        clocks: the processes' clocks must be such that they can be set.
    """

    place: RelayPlacement | None
    recorder: bool
    clocks: bool

    @classmethod
    def of(cls, fault: Fault) -> Needs:
        """What this fault needs."""
        recorder = (FillDisk(), Kill(Process.RECORDER), Freeze(Process.RECORDER))
        return cls(
            place=RelayPlacement.of(fault),
            recorder=fault.action in recorder,
            clocks=isinstance(fault.action, StepClock | SetWallClock | BeginInThePast),
        )

    @property
    def alone(self) -> bool:
        """Whether a cell serves for one such fault: a recorder writes one file, and no clock jumps back again."""
        return self.recorder or self.clocks


@contextmanager
def moving_cell(loaded: LoadedCell, robot: str, needs: Needs, seed: int = 0) -> Iterator[MovingCell]:
    """Start the cell's services and a controller that moves the robot.

    Args:
        loaded: the cell; nobody else may run it.
        robot: the one that moves.
        needs: what the faults need that it shall suffer.
        seed: of the relay's random numbers.

    Raises:
        NoCompilerError: if clocks shall be set, and the library for that cannot be made.
    """
    description = loaded.model.description
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        records = {name: folder / f"{name}.csv" for name in loaded.model.robots}
        services = [_recorded(service, records) for service in cell_services(description, str(loaded.file))]
        port, relay = description.tcp_port, None
        if needs.place is not None:
            relay = stack.enter_context(placed(needs.place, description, robot, seed))
            services = relay.with_relays(services, loaded, robot, folder)
            port = relay.controller_port
        home = loaded.model.robots[robot].home[0]
        arguments = ("-m", "deltaq_testing.faults.mover", str(port), robot, f"{home}")
        services.append(Service(Process.CONTROLLER, Role.LEADER, arguments, needs=("hli",)))
        if needs.recorder:
            services.append(recorder(str(loaded.file), str(folder / "run.mcap")))
        clocks = SettableClocks(folder) if needs.clocks else None
        python = (sys.executable,) if clocks is None else clocks.python
        launcher = stack.enter_context(Launcher(services, lambda *_: None, python=python, signals_raise=True))
        panel = stack.enter_context(PanelClient(description, robot))
        launcher.start()
        yield MovingCell(launcher, panel, records, relay, clocks)


def _recorded(service: Service, records: dict[str, Path]) -> Service:
    if service.role is not Role.EMULATOR or service.robot is None:
        return service
    return replace(service, arguments=(*service.arguments, "--record", str(records[service.robot])))


def rows_of(record: Path, from_byte: int = 0) -> Array:
    """Whole rows of a record that is being written: cycle, q (n), setpoint (n), 1 while RSI runs.

    Args:
        record: the file.
        from_byte: where to begin; the line there is left out, as the heading is.
    """
    with record.open(encoding="utf-8") as file:
        file.seek(from_byte)
        text = file.read()
    lines = text[: text.rfind("\n")].splitlines()[1:]
    rows = []
    for line in lines:
        cycle, _, *numbers, state = line.split(",")
        rows.append([float(cycle), *map(float, numbers), float(state == KrcState.RSI_RUNNING)])
    return np.array(rows)
