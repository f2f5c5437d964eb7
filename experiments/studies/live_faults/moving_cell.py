"""A cell of real processes with a robot that moves, and the record that every emulated controller keeps."""

from __future__ import annotations

import json
import socket
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services, recorder
from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.sayings import SIM, robot_server
from deltaq_services.guarded_realm import guarded_links
from deltaq_testing.faults.catalogue import (
    BeginInThePast,
    Fault,
    FillDisk,
    Freeze,
    Impair,
    ImpairStream,
    Kill,
    SetWallClock,
    StepClock,
)
from deltaq_testing.faults.panel import PanelClient
from deltaq_testing.impairment.relay import TrafficUnit
from deltaq_testing.impairment.tcp import StreamFaults
from deltaq_testing.live import recorded
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Link, Process
from studies.live_faults.clocks import SettableClocks
from studies.live_faults.relay_process import RelayProcess

HERE = "127.0.0.1"
RELAY = "relay"
"""Name of its Unix socket, beside those of the services."""


@dataclass(frozen=True)
class RelayPlacement:
    """A wire, and the unit that is impaired on it."""

    link: Link
    unit: TrafficUnit

    @classmethod
    def of(cls, fault: Fault) -> RelayPlacement | None:
        """Where a relay has to stand for this fault; None if it needs none."""
        match fault.action:
            case Impair(Link.CONTROLLER_HLI, _):
                return cls(Link.CONTROLLER_HLI, TrafficUnit.LINES)
            case Impair(Link.KRC_SERVER, _):
                return cls(Link.KRC_SERVER, TrafficUnit.DATAGRAMS)
            case Impair(link, _):
                return cls(link, TrafficUnit.MESSAGES)
            case ImpairStream(link, _):
                return cls(link, TrafficUnit.BYTES)
        return None


@dataclass(frozen=True)
class PlacedRelay:
    """A relay at work.

    Attributes:
        controller_port: where controllers connect.
    """

    place: RelayPlacement
    process: RelayProcess
    listen: Endpoint
    controller_port: int

    def impair(self, faults: StreamFaults | LinkFaults) -> None:
        """Do this to the wire from now on."""
        self.process.impair(faults)

    def lift(self) -> None:
        """Let the wire be unimpaired again."""
        self.process.impair(self.place.unit.faults())

    def with_relays(
        self, services: Sequence[Service], loaded: LoadedCell, robot: str, folder: Path
    ) -> list[Service]:
        """The services, of which the one that connects over the wire finds the relay there."""
        link, here = self.place.link, f"local/{RELAY}"
        server = f"robots: {{{robot}: {{server: {here}}}}}\n"
        match link:
            case Link.CONTROLLER_HLI:
                return list(services)
            case Link.KRC_SERVER:
                emulator, where = f"emulator-{robot}", ("--server", f"{HERE}:{self.listen.port}")
                return [
                    replace(service, arguments=(*service.arguments, *where))
                    if service.name == emulator
                    else service
                    for service in services
                ]
            case Link.HLI_SIM:
                name, change = "hli", f"sim: {here}\n"
            case Link.HLI_SERVER:
                name, change = "hli", server
            case Link.SIM_SERVER:
                name, change = "sim", server
        file = folder / "over-a-relay.yaml"
        file.write_text(f"extends: {json.dumps(str(loaded.file.resolve()))}\n{change}", encoding="utf-8")
        return [_of_cell(service, file) if service.name == name else service for service in services]


@contextmanager
def placed(place: RelayPlacement, cell: CellDescription, robot: str, seed: int) -> Iterator[PlacedRelay]:
    """A relay in a wire of a cell that is not up yet.

    Args:
        place: the wire.
        cell: description of the cell.
        robot: whose Robot Server is at the end of the wire, where one is.
        seed: of the random numbers.
    """
    links = guarded_links(cell)
    ends = {
        Link.CONTROLLER_HLI: f"tcp/{cell.tcp_address}:{cell.tcp_port}",
        Link.HLI_SIM: links[SIM],
        Link.HLI_SERVER: links[robot_server(robot)],
        Link.SIM_SERVER: links[robot_server(robot)],
    }
    if isinstance(driver := cell.robots[robot].driver, RsiDescription):
        ends[Link.KRC_SERVER] = f"udp/{driver.address}:{driver.port}"
    to = Endpoint.parse(ends[place.link])
    if to.transport == "unixsock-stream":
        listen = Endpoint(to.transport, str(Path(to.host).with_name(f"{RELAY}.sock")), 0)
    else:
        listen = Endpoint(to.transport, HERE, _free_port(to.transport))
    with RelayProcess(listen, to, place.unit, seed) as process:
        of_controllers = (
            listen if place.link is Link.CONTROLLER_HLI else Endpoint.parse(ends[Link.CONTROLLER_HLI])
        )
        yield PlacedRelay(place, process, listen, of_controllers.port)


def _of_cell(service: Service, file: Path) -> Service:
    arguments = list(service.arguments)
    arguments[arguments.index("--cell") + 1] = str(file)
    return replace(service, arguments=tuple(arguments))


def _free_port(transport: str) -> int:
    with socket.socket(type=socket.SOCK_DGRAM if transport == "udp" else socket.SOCK_STREAM) as probe:
        probe.bind((HERE, 0))
        port: int = probe.getsockname()[1]
        return port


@dataclass(frozen=True)
class MovingCell:
    """A cell of real processes whose robot is moved.

    Attributes:
        launcher: of its services.
        panel: of the robot's emulated controller.
        records: of every emulated controller.
        relay: in the impaired wire, if any.
        clocks: of its processes, if they can be set.
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
        loaded: the cell; no other process may run it.
        robot: the moving robot.
        needs: of the faults to be injected.
        seed: of the relay's random numbers.

    Raises:
        NoCompilerError: if clocks shall be set, and the library for that cannot be made.
    """
    description = loaded.model.description
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        records = {name: folder / f"{name}.csv" for name in loaded.model.robots}
        services = [recorded(service, records) for service in cell_services(description, str(loaded.file))]
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
