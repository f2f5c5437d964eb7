"""The table of services: the processes of a cell, their order, and their health checks.

`deltaq up`, `deltaq demo`, `deltaq status --service`, `compose.yaml` and the documentation all follow from this table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from typing import Literal

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.real_time import SchedulingPriority
from deltaq_services.guarded_realm import realm_of
from deltaq_services.video_stream import video_streams


class Role(StrEnum):
    """The role of a service."""

    ROBOT_SERVER = "robot-server"
    EMULATOR = "emulator"
    SIM = "sim"
    HLI = "hli"
    LEADER = "leader"
    FOLLOWER = "follower"
    RECORDER = "recorder"
    METRICS = "metrics"
    CONSOLE = "console"
    VIDEO = "video"


BRAKING_ROLES = (Role.ROBOT_SERVER, Role.EMULATOR)
"""What a robot needs to come to rest once the gate is silent."""


OPTIONAL_ROLES = (Role.CONSOLE, Role.METRICS, Role.VIDEO)
"""What a cell runs without."""


ORDINARY_ROLES = (Role.CONSOLE, Role.VIDEO)
"""What shows: it runs at ordinary priority."""


GUARDED_ROLES = (Role.ROBOT_SERVER, Role.SIM, Role.HLI)
"""What speaks in the guarded realm."""


class Probe(StrEnum):
    """How to ask a service whether it is healthy."""

    HEALTH_TOPIC = "health topic"
    """It publishes `guarded.Health` on `topics.HEALTH`, at the endpoint given."""
    STATUS_QUERY = "status query"
    """It answers `topics.STATUS`, at the endpoint given."""
    PANEL = "panel"
    """It answers `{"op": "status"}` in a UDP datagram, at the endpoint given."""
    WEB = "web"
    """It answers `GET /health` with a JSON object, at the endpoint given."""
    VIDEO = "video"
    """It serves the live picture that the endpoint names."""


@dataclass(frozen=True)
class ListeningSocket:
    """A socket that a service listens on.

    Attributes:
        transport: of the socket.
        address: it is bound to.
        port: it is bound to.
        field: the field of the cell's description that sets it.
    """

    transport: Literal["tcp", "udp"]
    address: str
    port: int
    field: str


@dataclass(frozen=True)
class Service:
    """One row of the table.

    Attributes:
        name: its name on the command line.
        role: its kind.
        arguments: of the Python interpreter.
        needs: services that must be ready before this one starts.
        listens: sockets that must be free before it starts.
        robot: the one it serves; None if it serves the whole cell.
        probe: how to ask for its health; None for controllers, which come and go.
        endpoint: where to ask, as the cell's file has it, or `udp/HOST:PORT` or `http://HOST:PORT`, or a live picture.
        realm: the folder of sockets of its guarded realm, as `guarded_realm.realm_of` names it; None if it speaks in
            none, or in one over TLS.
    """

    name: str
    role: Role
    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    listens: tuple[ListeningSocket, ...] = ()
    robot: str | None = None
    probe: Probe | None = None
    endpoint: str | None = None
    realm: str | None = None


def cell_services(
    cell: CellDescription, cell_name: str, real: bool = False, audit: str = ""
) -> tuple[Service, ...]:
    """The services of a cell, each after those that it needs.

    Args:
        cell: the cell's description.
        cell_name: the name or path from which the services load it.
        real: real robots, so no emulator.
        audit: file of the HLI's audit log; empty: its environment decides.
    """
    arguments = ("--cell", cell_name)
    realm = realm_of(cell)
    services: list[Service] = []
    for name, robot in cell.robots.items():
        server = f"robot-server-{name}"
        listens = [*_guarded_sockets(robot.server, f"robots.{name}.server")]
        if isinstance(robot.driver, RsiDescription):
            driver = robot.driver
            listens.append(ListeningSocket("udp", driver.address, driver.port, f"robots.{name}.driver.port"))
        services.append(
            Service(
                name=server,
                role=Role.ROBOT_SERVER,
                arguments=("-m", "deltaq_services.robot_server", *arguments, "--robot", name),
                listens=tuple(listens),
                robot=name,
                probe=Probe.HEALTH_TOPIC,
                endpoint=robot.server,
                realm=realm,
            )
        )
        if not real and isinstance(robot.driver, RsiDescription):
            services.append(_emulator(name, robot.driver, arguments, needs=server))
    services.append(
        Service(
            name="sim",
            role=Role.SIM,
            arguments=("-m", "deltaq_services.sim", *arguments),
            needs=tuple(service.name for service in services if service.role is Role.ROBOT_SERVER),
            listens=_guarded_sockets(cell.sim, "sim"),
            probe=Probe.HEALTH_TOPIC,
            endpoint=cell.sim,
            realm=realm,
        )
    )
    services.append(
        Service(
            name="hli",
            role=Role.HLI,
            arguments=("-m", "deltaq_services.hli", *arguments, *(("--audit", audit) if audit else ())),
            needs=("sim",),
            listens=(
                *_sockets(cell.hli, "hli"),
                ListeningSocket("tcp", cell.tcp_address, cell.tcp_port, "tcp_port"),
            ),
            probe=Probe.STATUS_QUERY,
            endpoint=cell.hli,
            realm=realm,
        )
    )
    return tuple(services)


def demo_controllers(cell: CellDescription) -> tuple[Service, ...]:
    """The controllers of the demonstration: a scripted leader, and the camera that follows it."""
    url = ("--url", cell.hli)
    return (
        Service("leader", Role.LEADER, ("-m", "deltaq_controllers.leader", *url), needs=("hli",)),
        Service(
            "follower", Role.FOLLOWER, ("-m", "deltaq_controllers.camera_follower", *url), needs=("hli",)
        ),
    )


def console_service(
    cell: CellDescription, cell_name: str, services: Sequence[Service], recordings: str = ""
) -> Service:
    """The operator's console: a client like any other; no service needs it.

    It calls the robots emulated only if emulators of all RSI robots run beside it; a kinematic driver has no
    physical robot. It does not wait for the HLI, and shows whether there is one.

    Args:
        cell: the cell's description.
        cell_name: the name or path from which the service loads it.
        services: those that run beside it.
        recordings: folder in which it writes and opens recordings; empty for none.
    """
    arguments: tuple[str, ...] = ("-m", "deltaq_services.console", "--cell", cell_name)
    if recordings:
        arguments = (*arguments, "--recordings", recordings)
    emulators = {service.robot: service.name for service in services if service.role is Role.EMULATOR}
    driven = {name for name, robot in cell.robots.items() if isinstance(robot.driver, RsiDescription)}
    is_emulated = driven == set(emulators)
    return Service(
        name="console",
        role=Role.CONSOLE,
        arguments=(*arguments, "--emulated") if is_emulated else arguments,
        needs=tuple(emulators.values()) if is_emulated else (),
        listens=(ListeningSocket("tcp", cell.console_address, cell.console_port, "console_port"),),
        probe=Probe.WEB,
        endpoint=f"http://{_reached_at(cell.console_address)}:{cell.console_port}",
    )


def video_services(cell: CellDescription, cell_name: str) -> tuple[Service, ...]:
    """The live pictures of a cell, one service each; no service needs them."""
    arguments = ("-m", "deltaq_services.video", "--cell", cell_name, "--stream")
    return tuple(
        Service(
            name=f"video-{stream.name}",
            role=Role.VIDEO,
            arguments=(*arguments, stream.name),
            robot=stream.robot,
            probe=Probe.VIDEO,
            endpoint=stream.name,
        )
        for stream in video_streams(cell)
    )


def console_is_installed() -> bool:
    """Whether the libraries of the console, the extra `console`, are installed."""
    return find_spec("uvicorn") is not None and find_spec("websockets") is not None


def recorder(cell_name: str, file: str) -> Service:
    """The recorder, started on demand: it only listens, and no service needs it."""
    arguments = ("-m", "deltaq_services.recorder", "--cell", cell_name, "--file", file)
    return Service("recorder", Role.RECORDER, arguments, needs=("hli",))


def metrics_exporter(cell_name: str) -> Service:
    """The exporter of metrics for Prometheus: a client that only reads; no service needs it."""
    return Service(
        "metrics", Role.METRICS, ("-m", "deltaq_services.metrics", "--cell", cell_name), needs=("hli",)
    )


def select(services: Sequence[Service], names: Sequence[str]) -> tuple[Service, ...]:
    """The rows with these names or roles, in the order of the table.

    Raises:
        DeltaqError: if a name is neither.
    """
    for name in names:
        if not any(name in (service.name, service.role) for service in services):
            raise _unknown(services, name)
    return tuple(service for service in services if service.name in names or service.role in names)


def one(services: Sequence[Service], name: str) -> Service:
    """The row of this name.

    Raises:
        DeltaqError: if there is none.
    """
    for service in services:
        if service.name == name:
            return service
    raise _unknown(services, name)


def _unknown(services: Sequence[Service], name: str) -> DeltaqError:
    allowed = ", ".join(service.name for service in services)
    return DeltaqError(f"no service {name!r} in this cell; it has {allowed}")


def _reached_at(address: str) -> str:
    """The address by which this machine reaches a listener."""
    everywhere = {"0.0.0.0": "127.0.0.1", "::": "::1"}
    host = everywhere.get(address, address)
    return f"[{host}]" if ":" in host else host


def _guarded_sockets(endpoint: str, field: str) -> tuple[ListeningSocket, ...]:
    return _sockets(endpoint, field) if endpoint.startswith("tls/") else ()


def _sockets(endpoint: str, field: str) -> tuple[ListeningSocket, ...]:
    at = Endpoint.parse(endpoint)
    return tuple(ListeningSocket(kind, *at.address, field) for kind in at.sockets)


def _emulator(robot: str, driver: RsiDescription, arguments: tuple[str, ...], needs: str) -> Service:
    # a KRC gives up after some cycles without a reply, so the Robot Server comes first
    panel = driver.control_port
    where = f"robots.{robot}.driver.control_port"
    return Service(
        name=f"emulator-{robot}",
        role=Role.EMULATOR,
        arguments=("-m", "deltaq_emulator", *arguments, "--robot", robot),
        needs=(needs,),
        listens=() if panel is None else (ListeningSocket("udp", driver.address, panel, where),),
        robot=robot,
        probe=None if panel is None else Probe.PANEL,
        endpoint=None if panel is None else str(Endpoint("udp", driver.address, panel)),
    )


@dataclass(frozen=True)
class Resources:
    """Limits of one service.

    Attributes:
        memory_mb: of its processes and their files in `/tmp` [MiB]; there is no swap beyond it.
        tasks: processes and threads.
        cores: of processor time; threads at real-time priority are not limited.
        real_time: greatest real-time priority that it may ask for; 0 for none.
    """

    memory_mb: int
    tasks: int
    cores: float
    real_time: int = 0


RESOURCES: dict[Role, Resources] = {
    Role.ROBOT_SERVER: Resources(
        memory_mb=384, tasks=64, cores=1.0, real_time=SchedulingPriority.ROBOT_SERVER
    ),
    Role.EMULATOR: Resources(memory_mb=384, tasks=16, cores=1.0, real_time=SchedulingPriority.EMULATOR),
    Role.SIM: Resources(memory_mb=1024, tasks=64, cores=1.0, real_time=SchedulingPriority.SIM),
    Role.HLI: Resources(memory_mb=1024, tasks=384, cores=1.0, real_time=SchedulingPriority.HLI),
    Role.CONSOLE: Resources(memory_mb=2048, tasks=256, cores=2.0),
    Role.LEADER: Resources(memory_mb=768, tasks=64, cores=1.0, real_time=SchedulingPriority.CONTROLLER),
    Role.FOLLOWER: Resources(memory_mb=1024, tasks=64, cores=1.0, real_time=SchedulingPriority.CONTROLLER),
    Role.METRICS: Resources(memory_mb=384, tasks=64, cores=0.5),
    Role.RECORDER: Resources(memory_mb=768, tasks=64, cores=0.5),
}
"""What each service was seen to use in the lab cell at 12 ms with leader, follower and console, and room.

Containers and systemd have the same limits, so that a leak or a flood takes one service and not the machine.
"""
