"""`python -m deltaq_services.sim --cell lab`."""

import logging

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.real_time import SIM_PLACE, SchedulingPriority, ask_for_real_time
from deltaq_services.process import arguments, run
from deltaq_services.sim.shell import Shell

_log = logging.getLogger(__name__)


def main() -> None:
    """Serve the gate of a cell."""
    options = arguments(
        "System Integrity Module: the gate, which admits only increments with a certified brake"
    )
    cell = CellModel.load(options.cell)
    ask_for_real_time(SchedulingPriority.SIM, SIM_PLACE)
    shell = Shell(cell)
    _log.info("ready: sim gates %s", ", ".join(cell.robots))
    shell.run()


if __name__ == "__main__":
    run(main, "sim")
