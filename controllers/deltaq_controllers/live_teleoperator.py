"""The teleoperator of a robot of a running cell, with all modes that the robot can be driven in."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial

from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.process import AdvisorProcess
from deltaq_controllers.criteria.normalised import check_known
from deltaq_controllers.criteria.postures import RobotData
from deltaq_controllers.live import cell_model, model_of, robot_models, where_others_are
from deltaq_controllers.modes.advisor import AdvisorMode, tracker_of
from deltaq_controllers.modes.coupled import CoupledMode, weighed
from deltaq_controllers.modes.motion import Frame, ModeName
from deltaq_controllers.modes.teleoperator import MODES, Teleoperator
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_protocol.client import Cell


def teleoperator_for(
    running: Cell,
    robot: str,
    stack: ExitStack,
    mode: ModeName = ModeName.JOINT,
    frame: Frame = Frame.WORLD,
    weights: Mapping[str, float] | None = None,
    jerk_time_s: float = 0.0,
    trade_off: tuple[str, str] | None = None,
    hands_may_leave: bool | None = False,
) -> Teleoperator:
    """A teleoperator as `deltaq drive` uses it; no mode but the first is made yet.

    Args:
        running: connection to the cell.
        robot: name of the robot.
        stack: ends what the modes have going on.
        mode: to begin with.
        frame: axes in which hands are moved.
        weights: of the criteria of `coupled` and `advisor`; their own if not given.
        jerk_time_s: time in which a joint's acceleration builds up to its limit; 0 sets no limit to the jerk [s].
        trade_off: names of two criteria on whose front the advisor's options are; None: they are minima.
        hands_may_leave: whether hands may leave their place on the way to an option of the advisor, and come back;
            None: where nothing can be advised otherwise, for want of a joint to spare.

    Raises:
        ControllerError: the robot is unknown, or cannot be driven in that mode.
        CriterionError: an unknown criterion, or a weight that is negative or not finite.
    """
    for name in trade_off or ():
        check_known(name)
    description = running.description
    model = model_of(robot_models(description), robot)

    def advisor_mode(robot: RobotModel) -> AdvisorMode:
        others = where_others_are(running, robot.name)
        tracker = tracker_of(robot, hands_may_leave in (True, None))
        advisor = AdvisorProcess(description, tracker, others, weights)
        mode = AdvisorMode(robot, description.cycle_s, stack.enter_context(advisor))
        mode.trade_off = trade_off
        mode.hands_may_leave = not len(tracker.base) if hands_may_leave is None else hands_may_leave
        return mode

    modes = {**MODES, ModeName.ADVISOR: advisor_mode}
    cell = cell_model(description)
    if weights is not None:
        modes[ModeName.COUPLED] = partial(CoupledMode, criteria=(weighed(RobotData(cell, robot), weights),))
    around = RobotSurroundings(cell, robot)
    return Teleoperator(model, description.cycle_s, mode, frame, modes, around, jerk_time_s)
