"""Drive to one of the advisor's options in virtual time: through the gate, by the mode that an operator uses."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deltaq_controllers.advisor.advisor import Option, Progress
from deltaq_controllers.advisor.session import Answered
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, OperatorCommand
from deltaq_testing.virtual_cell.cell import VirtualCell

LONGEST_S = 120.0
"""Virtual time after which a robot that is not there has not reached its option."""


@dataclass(frozen=True)
class AdvisedDrive:
    """How a robot got to an option.

    Attributes:
        reached: whether it stands there.
        took_s: virtual time.
        outcomes: verdicts by outcome.
        hands_off_m: greatest distance of a hand from its place on the way; None if the path takes them elsewhere.
    """

    reached: bool
    took_s: float
    outcomes: dict[str, int]
    hands_off_m: float | None


def driven_to(
    cell: str, robot: str, start: Array, advised: Callable[[Array], Option | None]
) -> AdvisedDrive | None:
    """Start a cell with the robot at a configuration, ask where it stands then, and go to the option.

    Args:
        cell: name of the cell.
        robot: name of the robot.
        start: (n,) where it begins; where it stands differs by the rounding of its telegrams.
        advised: the option for the setpoint (n,) at which it stands, or none.
    """
    stack = VirtualCell(cell, {robot: start})
    model, cycle_s = stack.cell.robots[robot], stack.cell.description.cycle_s
    stack.run_until_ready()
    stack.acquire(robot, "advised")
    tracker = ConstraintTracker(model)
    option = advised(np.array(stack.states[robot].q_cmd))
    if option is None:
        return None
    answered = Answered(tracker, Progress("finding paths", 1.0, option.energy, 0, (option,)))
    modes = {DrivingMode.ADVISOR: lambda robot: AdvisorMode(robot, cycle_s, answered)}
    teleoperator = Teleoperator(model, cycle_s, DrivingMode.ADVISOR, modes=modes)
    teleoperator.command = OperatorCommand(option=1)
    places, off_m = tracker.hands(option.start)[:, :3, 3], 0.0
    outcomes: dict[str, int] = {}
    cycles = 0
    while teleoperator.arrived_at is None and cycles * cycle_s < LONGEST_S:
        stack.cycle()
        cycles += 1
        views = {name: RobotView.from_state(state) for name, state in stack.states.items()}
        verdict = stack.ask(robot, teleoperator.increment(View(views.pop(robot), views)))
        if verdict is not None:
            teleoperator.take_verdict(verdict)
            outcomes[verdict.outcome.value] = outcomes.get(verdict.outcome.value, 0) + 1
        q = np.array(stack.states[robot].q)
        off_m = max(off_m, float(np.linalg.norm(tracker.hands(q)[:, :3, 3] - places, axis=1).max()))
    return AdvisedDrive(
        reached=teleoperator.arrived_at is not None,
        took_s=cycles * cycle_s,
        outcomes=outcomes,
        hands_off_m=None if option.hands_move else off_m,
    )
