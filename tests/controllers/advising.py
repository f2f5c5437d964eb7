"""A teleoperator with all five modes, whose adviser answers at once."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from driving import CYCLE_S
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.advisor import Progress
from deltaq_controllers.advisor.counsel import Counsel
from deltaq_controllers.criteria.postures import RobotData
from deltaq_controllers.modes.advisor import Advice, AdvisorMode, tracker_of
from deltaq_controllers.modes.coupled import CoupledMode, weighed
from deltaq_controllers.modes.motion import ModeName
from deltaq_controllers.modes.switch import MODES, Teleoperator

Array = NDArray[np.float64]


class AtOnce:
    """The advisor's counsel in the loop itself: in virtual time it takes none."""

    trouble = ""
    is_busy = False

    def __init__(self, counsel: Counsel) -> None:
        self.tracker = counsel.tracker
        self.progress: Progress | None = None
        self._counsel = counsel

    def ask(self, q: Array) -> None:
        self._counsel.ask(q, {}, self._take)

    def seek(self, back: Array, rank: int) -> None:
        self._counsel.seek(back, rank, {}, self._take)

    def give_up(self) -> None:
        """Nothing is going on."""

    def _take(self, progress: Progress) -> bool:
        self.progress = progress
        return True


@cache
def cell_of(robot: str) -> CellModel:
    return CellModel.load("dawm" if robot == "dawm" else "lab")


def advised(
    robot: RobotModel,
    mode: ModeName = ModeName.ADVISOR,
    weights: dict[str, float] | None = None,
    adviser: Advice | None = None,
) -> Teleoperator:
    def advisor(robot: RobotModel) -> AdvisorMode:
        tracker_of(robot)
        answers = adviser or AtOnce(Counsel(cell_of(robot.name), robot.name, options=3, effort=0.2))
        return AdvisorMode(robot, CYCLE_S, answers)

    modes = {**MODES, ModeName.ADVISOR: advisor}
    if weights is not None:
        criteria = (weighed(RobotData(cell_of(robot.name), robot.name), weights),)
        modes[ModeName.COUPLED] = partial(CoupledMode, criteria=criteria)
    return Teleoperator(robot, CYCLE_S, mode, modes=modes)


def advisor_of(teleoperator: Teleoperator) -> AdvisorMode:
    mode = teleoperator.mode_named(ModeName.ADVISOR)
    assert isinstance(mode, AdvisorMode)
    return mode
