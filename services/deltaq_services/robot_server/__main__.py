"""`python -m deltaq_services.robot_server --cell lab --robot fr`."""

from deltaq_cell.description import RsiDriver
from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.load import load_cell
from deltaq_protocol.errors import DeltaqError
from deltaq_services.process import arguments, run
from deltaq_services.robot_server.shell import serve


def main() -> None:
    """Serve one robot of a cell."""
    options = arguments("Robot Server: relays what passed the gate to one robot's controller", of_robot=True)
    cell = load_cell(options.cell)
    if options.robot not in cell.robots:
        raise DeltaqError(f"cell {cell.cell} has no robot {options.robot!r}; it has {', '.join(cell.robots)}")
    driver = cell.robots[options.robot].driver
    xml = (
        resolve_near(find_cell(options.cell), driver.ethernet_xml) if isinstance(driver, RsiDriver) else None
    )
    serve(cell, options.robot, xml)


if __name__ == "__main__":
    run(main)
