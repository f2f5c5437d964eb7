"""`python -m deltaq_services.sim --cell lab`."""

import logging

from deltaq_cell.cell_model import CellModel
from deltaq_services.process import arguments, ask_for_real_time, run
from deltaq_services.sim.shell import Shell

_log = logging.getLogger(__name__)

_REAL_TIME_PRIORITY = 10
"""Between the Robot Servers' and the HLI's."""


def main() -> None:
    """Serve the gate of a cell."""
    options = arguments("System Integrity Module: the gate that admits only what can still be braked")
    cell = CellModel.load(options.cell)
    ask_for_real_time(_REAL_TIME_PRIORITY)
    shell = Shell(cell)
    _log.info("ready: sim gates %s on %s", ", ".join(cell.robots), cell.description.sim)
    shell.run()


if __name__ == "__main__":
    run(main, "sim")
