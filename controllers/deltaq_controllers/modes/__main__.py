"""Compile the modes of driving by hand, so that no first lease waits: `python -m deltaq_controllers.modes [CELL]`.

Prints its progress, and does nothing if all is stored from an earlier run.
"""

import argparse
import hashlib
from pathlib import Path

from deltaq_cell.load import load_cell
from deltaq_cell.machine_code import folder, is_complete, mark_complete
from deltaq_protocol.errors import DeltaqError

_PACKAGE = Path(__file__).parents[1]
FUNCTIONS = 140
"""About as many are compiled."""


def main() -> int:
    """Compile every mode for every robot of the cell, by a cycle on the robot's model."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_controllers.modes", description=__doc__)
    parser.add_argument(
        "cell", nargs="?", default="lab", metavar="CELL", help="name or YAML file of the cell (default: lab)"
    )
    cell: str = parser.parse_args().cell
    try:
        # which functions a robot needs depends on its arms: cells of the same arms need the same
        models = sorted({robot.model for robot in load_cell(cell).robots.values()})
        name = f"modes-{hashlib.sha256(repr(models).encode()).hexdigest()[:16]}"
        where = folder(_PACKAGE)
        if not is_complete(where, name, _PACKAGE):
            compile_ahead(cell)
            mark_complete(where, name, _PACKAGE)
    except DeltaqError as error:
        parser.exit(2, f"error: {error}\n")
    return 0


def compile_ahead(cell: str) -> None:
    """Drive every robot of the cell, on its model alone."""
    # heavy packages are imported only if something is left to do
    from deltaq_cell.cell_model import CellModel
    from deltaq_cell.machine_code import compiling_shown
    from deltaq_cell.robot import RobotModel
    from deltaq_controllers.advisor.session import AdvisorSession, SynchronousAdvisor
    from deltaq_controllers.modes.advisor import AdvisorMode, tracker_of
    from deltaq_controllers.modes.practice import practise
    from deltaq_controllers.modes.teleoperator import MODES, Teleoperator
    from deltaq_controllers.surroundings.surroundings import RobotSurroundings
    from deltaq_protocol.driving import DrivingMode

    model = CellModel.load(cell)
    cycle_s = model.description.cycle_s

    def advisor_mode(robot: RobotModel) -> AdvisorMode:
        tracker_of(robot, hands_may_leave=True)
        return AdvisorMode(robot, cycle_s, SynchronousAdvisor(AdvisorSession(model, robot.name)))

    modes = {**MODES, DrivingMode.ADVISOR: advisor_mode}
    with compiling_shown("the modes of driving by hand", FUNCTIONS):
        for name, robot in model.robots.items():
            around = RobotSurroundings(model, name)
            teleoperator = Teleoperator(robot, cycle_s, modes=modes, surroundings=around)
            teleoperator.make_modes()
            practise(teleoperator)


if __name__ == "__main__":
    raise SystemExit(main())
