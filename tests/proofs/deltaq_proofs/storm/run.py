"""A whole storm: the cell's processes are started, attacked while the robot moves, and what was sent is judged."""

import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from deltaq_cell.description import RsiDescription
from deltaq_cell.find import resolve_near
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services
from deltaq_emulator.settings import KrcSettings
from deltaq_proofs.storm.forger import Forger, Overheard
from deltaq_proofs.storm.line import AttackedLine
from deltaq_proofs.storm.operator import StormOperator
from deltaq_proofs.storm.witness import Admitted, Passed, UnexplainedError, Witness
from deltaq_protocol.endpoint import Address
from deltaq_protocol.rsi import AxisMap, KrcCodec, load_ethernet_xml
from deltaq_services.robot_server.probe_trial import pulse_offsets
from deltaq_services.robot_server.rsi_driver import sensor_codec
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process

_PATIENT = {"late_budget": 1_000_000, "late_percent": 100.0}
"""A KRC that never gives up, which gives the attacker more to attack."""
_ADMITTED = 50
"""Admissions after which the robot moves, and the attack begins."""
_LOOK_S = 0.05
_SETTLED_S = 1.0
"""What the last admissions may take to be heard."""


@dataclass(frozen=True)
class StormReport:
    """What a storm came to.

    Attributes:
        forged: datagrams of the attacker.
        replies: by what explains them.
        admissions: heard of the gate.
        unheard: admissions that the gate numbered, and that were lost on their way to the witness.
        server: the Robot Server's counters in the end.
        unexplained: the first correction that nothing explains; None if all are.
    """

    forged: int
    replies: dict[str, int]
    admissions: int
    unheard: int
    server: dict[str, int]
    unexplained: str | None


def run_storm(
    loaded: LoadedCell,
    robot: str,
    telegrams: int,
    rate_hz: float,
    seed: int = 0,
) -> StormReport:
    """Start the cell, let a controller move the robot, attack its wire, and judge every reply.

    Args:
        loaded: the cell; nobody else may run it.
        robot: whose wire is attacked.
        telegrams: how many datagrams the attacker sends.
        rate_hz: how many of them a second.
        seed: of the attacker.

    Raises:
        LaunchError: if a service does not come up.
    """
    description = loaded.model.description
    driver = description.robots[robot].driver
    assert isinstance(driver, RsiDescription)  # `load_rsi_cell` has seen to that
    passed: list[Passed] = []
    forger = Forger(seed)
    server = (driver.address, driver.port)
    with AttackedLine(server, forger, rate_hz, passed.append) as line, ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        services = _services(loaded, robot, line.address, folder)
        launcher = stack.enter_context(Launcher(services, lambda *_: None, signals_raise=True))
        launcher.start()
        overheard = stack.enter_context(Overheard(description, robot))
        # only now: no admission may come before somebody listens
        mover = Launcher([_mover(loaded, robot)], lambda *_: None, signals_raise=True)
        stack.enter_context(mover).start()
        stack.enter_context(StormOperator(description, robot))

        def look_until(enough: Callable[[], bool]) -> None:
            while not enough():
                overheard.take()
                time.sleep(_LOOK_S)

        look_until(lambda: len(overheard.admissions) >= _ADMITTED)
        line.goal = telegrams
        look_until(lambda: line.forged >= telegrams)
        ended_s, last = time.monotonic(), len(passed)
        look_until(lambda: time.monotonic() >= ended_s + _SETTLED_S)
    axes = AxisMap.of(description.robots[robot].joint_names, description.robots[robot].units, driver.krc)
    xml = resolve_near(loaded.file, driver.ethernet_xml)
    of_server = KrcCodec(load_ethernet_xml(xml), axes, driver.inputs, driver.outputs, stop=driver.stop)
    pulses = pulse_offsets(description.robots[robot], description.cycle_s)
    witness = Witness(sensor_codec(description, robot, xml), of_server, pulses)
    heard = [*overheard.admissions.values()]
    admitted = Admitted(heard, robot, description.robots[robot], description.cycle_s)
    unexplained = None
    try:
        witness.judge(passed[:last], admitted)
    except UnexplainedError as error:
        unexplained = str(error)
    return StormReport(
        forged=line.forged,
        replies=dict(witness.counts),
        admissions=len(heard),
        unheard=len(admitted.unheard),
        server=overheard.counters,
        unexplained=unexplained,
    )


def _services(loaded: LoadedCell, robot: str, line: Address, folder: Path) -> list[Service]:
    """The cell's; the robot's emulated KRC is patient, and finds the line where its Robot Server would be."""
    settings = folder / "patient.yaml"
    patient = KrcSettings.load().model_copy(update=_PATIENT)
    settings.write_text(patient.model_dump_json(), encoding="utf-8")  # which is YAML, too
    over = ("--server", f"{line[0]}:{line[1]}", "--settings", str(settings))
    return [
        replace(service, arguments=(*service.arguments, *over))
        if service.role is Role.EMULATOR and service.robot == robot
        else service
        for service in cell_services(loaded.model.description, str(loaded.file))
    ]


def _mover(loaded: LoadedCell, robot: str) -> Service:
    """A controller that moves the robot."""
    port, home = loaded.model.description.tcp_port, loaded.model.robots[robot].home[0]
    arguments = ("-m", "deltaq_testing.faults.mover", str(port), robot, f"{home}")
    return Service(Process.CONTROLLER, Role.LEADER, arguments)
