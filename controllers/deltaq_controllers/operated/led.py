"""Another robot as the master of an operated one: it leads a hand for as long as wishes say so."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Self

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.motion import OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.master import LookAtBoth, Master


class WishedClutch:
    """The clutch of wishes: it couples while they come, as a button does that is held.

    Attributes:
        hand: the hand that is led; None for all.
        is_clutched: whether the master leads.
    """

    status = "master"

    def __init__(self) -> None:
        self.hand: str | None = None
        self.is_clutched = False

    def read(self, _time_s: float, /) -> OperatorCommand | None:
        """It chooses only the coupling."""
        return OperatorCommand()

    def reflect(self, share: float) -> None:
        """Does nothing: the source of the wishes shows the fraction that goes through."""
        del share

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """No device is held."""


class LedByWishes:
    """Rates of the hands from a master's motion.

    Args:
        teleoperator: the robot that is driven.
        master: the robot that leads.
        look: returns what is seen of both.
        scale: way of the hand for each metre of the master's.

    Attributes:
        name: of the master.
        scale: as given.

    Raises:
        ControllerError: a robot cannot lead itself.
    """

    def __init__(
        self, teleoperator: Teleoperator, master: RobotModel, look: LookAtBoth, scale: float
    ) -> None:
        self.name, self.scale = master.name, scale
        self._clutch = WishedClutch()
        self._master = Master(teleoperator, master, look, self._clutch, scale)

    @property
    def status(self) -> str:
        """Whether it leads, and why not."""
        return self._master.status

    def rates(self, now_s: float, is_coupled: bool, hand: str | None) -> Mapping[str, float]:
        """Rates by axis, as of `OperatorCommand`; to be asked for in every cycle, coupled or not.

        Args:
            now_s: time [s].
            is_coupled: whether a wish couples it now.
            hand: the hand that is led; None for all.
        """
        self._clutch.is_clutched, self._clutch.hand = is_coupled, hand
        command = self._master.read(now_s)
        return {} if command is None else command.rates
