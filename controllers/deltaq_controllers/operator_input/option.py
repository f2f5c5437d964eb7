"""An operator that goes to one option of the advisor, and nowhere else."""

from __future__ import annotations

from typing import Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.motion import ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import OperatorInput

PATIENCE_S = 3.0
"""Time without progress, on the robot's clock, after which the drive ends."""


class GoToOption(OperatorInput):
    """Commands to be at an option, and is over when the robot is there.

    Args:
        teleoperator: of the robot, in mode `advisor`.
        option: its rank.

    Attributes:
        reached: whether the robot got there.
    """

    def __init__(self, teleoperator: Teleoperator, option: int) -> None:
        mode = teleoperator.mode_named(ModeName.ADVISOR)
        assert isinstance(mode, AdvisorMode)
        self._teleoperator, self._mode, self._option = teleoperator, mode, option
        self._got_on_s: float | None = None
        self._done = 0.0
        self.reached = False

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command; None when the robot is there.

        Raises:
            ControllerError: the robot makes no progress.
        """
        self.reached = self._mode.arrived_at == self._option
        if self.reached:
            return None
        if self._got_on_s is None or self._mode.done > self._done:
            self._got_on_s, self._done = time_s, self._mode.done
        if time_s - self._got_on_s > PATIENCE_S:
            limitation = self._teleoperator.limitation
            raise ControllerError(
                f"{self._teleoperator.robot.name} makes no progress after {100 * self._done:.0f} % of the path to "
                f"option {self._option}: {limitation.text if limitation else self._mode.status}; "
                "see `deltaq status` for its phase, and advise again from where it stands"
            )
        return OperatorCommand(option=self._option)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""
