"""Run every mode on the robot's model before the robot is driven, so that no first motion waits for compilation.

To compile a function at the first motion, or to load it from numba's cache, takes 0.2 to 0.7 s: dozens of cycles, and
on a busy machine long enough to lose the lease.
"""

from collections.abc import Callable, Iterator

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.modes.interface import TeleoperationMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.driving import DrivingMode, OperatorCommand

CYCLES = 3
"""Cycles of each command: one at rest, one at the start, one in motion."""

_RATE = 0.05


def practise(teleoperator: Teleoperator) -> None:
    """Drive every mode made so far along each of its axes, on the robot's model alone, from its home.

    The teleoperator itself is not changed: each mode practises in a separate one.

    Args:
        teleoperator: the teleoperator that will drive a robot afterwards.
    """
    robot, cycle_s, around = teleoperator.robot, teleoperator.cycle_s, teleoperator.surroundings
    for mode in teleoperator.made_modes:
        modes = {mode.name: _always(mode.stand_in())}
        practising = Teleoperator(robot, cycle_s, mode.name, modes=modes, surroundings=around)
        q, cycle = robot.home, 0
        for command in _commands(practising):
            practising.command = command
            for _ in range(CYCLES):
                cycle += 1
                q = q + practising.increment(View(RobotView(cycle, cycle * cycle_s, q, q)))


def _always(mode: TeleoperationMode) -> Callable[[RobotModel], TeleoperationMode]:
    return lambda _: mode


def _commands(teleoperator: Teleoperator) -> Iterator[OperatorCommand]:
    """Rest, and then every axis of the mode, or the path to an option."""
    yield OperatorCommand()
    if teleoperator.mode is DrivingMode.ADVISOR:
        yield OperatorCommand(option=1)
    for axis in teleoperator.axes(teleoperator.mode):
        yield OperatorCommand({axis: _RATE})
