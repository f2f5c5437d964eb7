"""`python -m deltaq_services.robot_server --cell lab --robot fr`."""

import logging
from pathlib import Path

from deltaq_cell.description import RobotDescription, RsiDescription
from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.krc_files import judge_krc_files
from deltaq_cell.load import load_cell
from deltaq_protocol import log
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.rsi import EthernetConfigError
from deltaq_services.process import arguments, run
from deltaq_services.robot_server.shell import serve

_log = logging.getLogger(__name__)
_SERVICE = "robot-server"


def main() -> None:
    """Serve one robot of a cell."""
    options = arguments("Robot Server: relays admitted setpoints to one robot's controller", of_robot=True)
    log.configure(_SERVICE, options.robot)
    cell = load_cell(options.cell)
    if options.robot not in cell.robots:
        raise DeltaqError(f"cell {cell.cell} has no robot {options.robot!r}; it has {', '.join(cell.robots)}")
    robot = cell.robots[options.robot]
    file = find_cell(options.cell)
    refuse_unsafe(file, robot, cell.cycle_s)
    xml = resolve_near(file, robot.driver.ethernet_xml) if isinstance(robot.driver, RsiDescription) else None
    serve(cell, options.robot, xml)


def refuse_unsafe(cell_file: Path, robot: RobotDescription, cycle_s: float) -> None:
    """Report the faults of the files of a robot's KRC.

    Raises:
        EthernetConfigError: they cannot be safe.
    """
    findings = judge_krc_files(cell_file, robot, cycle_s)
    for finding in findings:
        if finding.severity == "warning":
            _log.warning("%s", finding)
    if errors := [str(finding) for finding in findings if finding.severity == "error"]:
        raise EthernetConfigError("\n".join(["the KRC's files are refused:", *errors]))


if __name__ == "__main__":
    run(main, _SERVICE)
