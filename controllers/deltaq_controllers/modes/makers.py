"""What makes each mode of a robot of a known cell: `coupled` with criteria of one's choice, and `advisor`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.adviser import Adviser
from deltaq_controllers.criteria.normalised import check_weights
from deltaq_controllers.criteria.postures import RobotData
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.coupled import CoupledMode, weighed
from deltaq_controllers.modes.interface import Mode
from deltaq_controllers.modes.motion import ModeName
from deltaq_controllers.modes.switch import MODES, ModeTable


def all_modes(
    cell: Callable[[], CellModel],
    cycle_s: float,
    adviser: Callable[[RobotModel], Adviser],
    weights: Mapping[str, float] | None = None,
) -> ModeTable:
    """The five modes.

    Args:
        cell: makes the model of the cell, when it is first needed.
        cycle_s: cycle of the robot [s].
        adviser: makes the robot's adviser, when it is first needed.
        weights: of the criteria that `coupled` resolves redundancy by; joint travel if not given.

    Raises:
        CriterionError: an unknown criterion, or a weight that is negative or not finite.
    """
    check_weights(weights or {})

    def coupled(robot: RobotModel) -> Mode:
        if weights is None:
            return CoupledMode(robot)
        return CoupledMode(robot, (weighed(RobotData(cell(), robot.name), weights),))

    def advisor(robot: RobotModel) -> Mode:
        return AdvisorMode(robot, cycle_s, adviser(robot))

    return {**MODES, ModeName.COUPLED: coupled, ModeName.ADVISOR: advisor}
