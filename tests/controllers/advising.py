"""A teleoperator with all five modes, whose advisor answers at once."""

from __future__ import annotations

from functools import cache, partial

from driving import CYCLE_S

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.session import AdvisorSession, SynchronousAdvisor
from deltaq_controllers.criteria.formulas import RobotData
from deltaq_controllers.modes.advisor import Advisor, AdvisorMode, tracker_of
from deltaq_controllers.modes.hand_modes import CoupledMode, weighed
from deltaq_controllers.modes.teleoperator import MODES, Teleoperator
from deltaq_protocol.driving import DrivingMode


@cache
def cell_of(robot: str) -> CellModel:
    return CellModel.load("dawm" if robot == "dawm" else "lab")


def advised(
    robot: RobotModel,
    mode: DrivingMode = DrivingMode.ADVISOR,
    weights: dict[str, float] | None = None,
    advisor: Advisor | None = None,
    hands_may_leave: bool = False,
) -> Teleoperator:
    def advisor_mode(robot: RobotModel) -> AdvisorMode:
        tracker_of(robot, hands_may_leave)
        answers = advisor or SynchronousAdvisor(
            AdvisorSession(cell_of(robot.name), robot.name, options=3, effort=0.5)
        )
        made = AdvisorMode(robot, CYCLE_S, answers)
        made.hands_may_leave = hands_may_leave
        return made

    modes = {**MODES, DrivingMode.ADVISOR: advisor_mode}
    if weights is not None:
        criteria = (weighed(RobotData(cell_of(robot.name), robot.name), weights),)
        modes[DrivingMode.COUPLED] = partial(CoupledMode, criteria=criteria)
    return Teleoperator(robot, CYCLE_S, mode, modes=modes)


def advisor_of(teleoperator: Teleoperator) -> AdvisorMode:
    mode = teleoperator.mode_named(DrivingMode.ADVISOR)
    assert isinstance(mode, AdvisorMode)
    return mode
