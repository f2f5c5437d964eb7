"""A teleoperator with all five modes, whose adviser answers at once."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import cache
from typing import Any

from driving import CYCLE_S

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.adviser import Adviser
from deltaq_controllers.modes.advisor import AdvisorMode, tracker_of
from deltaq_controllers.modes.makers import all_modes
from deltaq_controllers.modes.motion import ModeName
from deltaq_controllers.modes.switch import Teleoperator


class AtOnce(Executor):
    """Runs what is submitted before it returns."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@cache
def cell_of(robot: str) -> CellModel:
    return CellModel.load("dawm" if robot == "dawm" else "lab")


def advised(
    robot: RobotModel,
    mode: ModeName = ModeName.ADVISOR,
    weights: dict[str, float] | None = None,
    executor: Executor | None = None,
) -> Teleoperator:
    def adviser(robot: RobotModel) -> Adviser:
        tracker, executes = tracker_of(robot), executor or AtOnce()
        return Adviser(lambda: cell_of(robot.name), tracker, options=3, effort=0.2, executor=executes)

    modes = all_modes(lambda: cell_of(robot.name), CYCLE_S, adviser, weights)
    return Teleoperator(robot, CYCLE_S, mode, modes=modes)


def advisor_of(teleoperator: Teleoperator) -> AdvisorMode:
    mode = teleoperator.mode_named(ModeName.ADVISOR)
    assert isinstance(mode, AdvisorMode)
    return mode
