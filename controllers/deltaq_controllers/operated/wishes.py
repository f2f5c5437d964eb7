"""The present motion command of a teleoperator, with its master and grip."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from deltaq_controllers.criteria import BY_NAME
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import hand_axis
from deltaq_controllers.operator_input.master import Master
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import HAND_AXES, WISH_S, DrivingMode, Grip, HandsOff, OperatorCommand

REST = OperatorCommand()


class Wishes:
    """The newest motion command, until it expires.

    Args:
        teleoperator: of the robot.
        make_master: makes the master of that name and scale, or raises `ControllerError`.

    Attributes:
        grip: whether all hands are to hold an object.
        master: the chosen master, or None.
    """

    def __init__(self, teleoperator: Teleoperator, make_master: Callable[[str, float], Master]) -> None:
        self._teleoperator, self._make_master = teleoperator, make_master
        self.grip = Grip.FREE
        self.master: Master | None = None
        self._hands = Hands(teleoperator.robot)
        self._cycles: int | None = None
        self.rest()

    def rest(self) -> None:
        """Wish for nothing."""
        self._wish, self._until_s, self._cycles = REST, -np.inf, None

    def take(self, wish: OperatorCommand, now_s: float, cycles: int | None = None) -> None:
        """Command this motion from now on, until it expires, or for so many cycles."""
        self._wish, self._until_s, self._cycles = wish, now_s + WISH_S, cycles

    def check(self, wish: OperatorCommand, mode: DrivingMode) -> None:
        """Check that a mode of the teleoperator can follow a command.

        Raises:
            ControllerError: the robot has no such axis, the mode does not drive it, or no master was chosen.
        """
        if wish.led is not None:
            if self.master is None:
                raise ControllerError("led: no master was chosen; choose another robot of the cell")
            wish = replace(wish, rates={hand_axis(wish.led or None, HAND_AXES[0]): 1.0})
        self._teleoperator.check(wish, mode, self.grip)

    def choose_master(self, name: str, scale: float) -> None:
        """Choose the robot that leads a hand while commands say so; an empty name means none.

        Callable from any thread.

        Raises:
            ControllerError: there is no such robot, or it is the driven robot itself.
        """
        master = self._make_master(name, scale) if name else None
        self.rest()
        self.master = master

    def command(self, now_s: float) -> OperatorCommand:
        """The command of this cycle; `REST` if it has expired."""
        lasts = now_s < self._until_s
        if self._cycles is not None:
            lasts, self._cycles = self._cycles > 0, max(0, self._cycles - 1)
        command = self._wish if lasts else REST
        return command if self.master is None else self.master.lead(command, now_s)

    def hands_off(self, q: Array) -> HandsOff | None:
        """By how much hands that hold an object are off from how they took it, measured at `q` (n,); None without."""
        held = self._teleoperator.held
        if held is None:
            return None
        self._hands.place(q)
        distance_m, angle_rad = held.parted(self._hands.rotations, self._hands.positions)
        # rounded, since a report goes out whenever it differs from the one before
        return HandsOff(distance_m=round(distance_m, 4), angle_rad=round(angle_rad, 4))


def check_grip(teleoperator: Teleoperator, grip: Grip, mode: DrivingMode) -> None:
    """Check that a robot can grip in a mode.

    Raises:
        ControllerError: it has one hand, or the mode would part the hands.
    """
    if mode not in (DrivingMode.POSE, DrivingMode.FOLLOW):
        teleoperator.check_grip(grip, mode)
        return
    teleoperator.check_grip(grip, DrivingMode.COUPLED)  # one hand is one in any mode
    if grip is Grip.OBJECT:
        raise ControllerError(
            f"mode {mode.value} would separate hands that hold an object; choose grip {Grip.FREE.value} first, "
            "or another mode"
        )


def check_trade_off(names: tuple[str, str] | None) -> None:
    """Check that these are two criteria, if any.

    Raises:
        ControllerError: an unknown criterion, or one criterion twice.
    """
    first, second = names or ("", "")
    for name in names or ():
        if name not in BY_NAME:
            raise ControllerError(f"trade_off: no criterion {name!r}; there are {', '.join(BY_NAME)}")
    if names is not None and first == second:
        raise ControllerError(f"trade_off: two different criteria, got {first!r} twice")
