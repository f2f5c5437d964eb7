"""What is wished of a teleoperator now, and by which master and with which grip."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Self

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.criteria import BY_NAME
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.motion import HAND_AXES, Grip, ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.master import LookAtBoth, Master
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import WISH_S, DrivingMode, HandsOff, Wish

# Another robot as the master of an operated one: it leads a hand for as long as wishes say so.


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


_REST = OperatorCommand()


class Wishes:
    """The newest wish, for as long as it lasts.

    Args:
        teleoperator: of the robot.
        make_led: makes what has a master of that name lead a hand, scaled, or raises `ControllerError`.

    Attributes:
        grip: whether all hands are to hold an object.
        led: the master that was chosen; None without one.
    """

    def __init__(self, teleoperator: Teleoperator, make_led: Callable[[str, float], LedByWishes]) -> None:
        self._teleoperator, self._make_led = teleoperator, make_led
        self.grip = Grip.FREE
        self.led: LedByWishes | None = None
        self._hands = Hands(teleoperator.robot)
        self.rest()

    def rest(self) -> None:
        """Wish for nothing."""
        self._take(_REST, Wish(), -np.inf)

    def take(self, wish: Wish, now_s: float) -> None:
        """Wish for this from now on, for as long as a wish lasts."""
        self._take(command_of(wish, self._teleoperator), wish, now_s + WISH_S)

    def _take(self, command: OperatorCommand, wish: Wish, until_s: float) -> None:
        self._command, self._wish, self._until_s = command, wish, until_s

    def check(self, wish: Wish, mode: ModeName) -> None:
        """Check that a wish can be followed in a mode of the teleoperator.

        Raises:
            ControllerError: the robot has no such axis, the mode does not drive it, or no master was chosen.
        """
        command = command_of(wish, self._teleoperator)
        if wish.led:
            if self.led is None:
                raise ControllerError("led: no master was chosen; choose another robot of the cell")
            command = OperatorCommand({axis_of(wish.hand, HAND_AXES[0]): 1.0})
        self._teleoperator.check(command, mode, self.grip)

    def choose_master(self, name: str, scale: float) -> None:
        """Have another robot lead a hand while wishes say so; none for an empty name. Any thread may.

        Raises:
            ControllerError: there is no such robot, or it is the driven robot itself.
        """
        led = self._make_led(name, scale) if name else None
        self.rest()
        self.led = led

    def command(self, now_s: float) -> OperatorCommand | None:
        """The command of this cycle; None if there is no wish."""
        lasts = now_s < self._until_s
        is_coupled = lasts and self._wish.led
        if self.led is not None:
            rates = self.led.rates(now_s, is_coupled, self._wish.hand or None)
            if is_coupled:
                return OperatorCommand(rates)
        return self._command if lasts and self._command != _REST else None

    def hands_off(self, q: Array) -> HandsOff | None:
        """By how much hands that hold an object are off from how they took it, measured at `q` (n,); None without."""
        held = self._teleoperator.held
        if held is None:
            return None
        self._hands.place(q)
        distance_m, angle_rad = held.parted(self._hands.rotations, self._hands.positions)
        # rounded, since a report goes out whenever it differs from the one before
        return HandsOff(distance_m=round(distance_m, 4), angle_rad=round(angle_rad, 4))


def is_rest(wish: Wish) -> bool:
    """Whether a wish is for nothing."""
    moves = any(wish.joints) or any(wish.twist or ())
    return not moves and wish.option is None and not wish.led


def command_of(wish: Wish, teleoperator: Teleoperator) -> OperatorCommand:
    """The command that a wish means; empty for one that a master is to lead.

    Raises:
        ControllerError: not a speed for each joint.
    """
    rates = {}
    if wish.joints:
        names = teleoperator.robot.joint_names
        if len(wish.joints) != len(names):
            raise ControllerError(f"joints: the robot has {len(names)}, got {len(wish.joints)} speeds")
        rates = {name: speed for name, speed in zip(names, wish.joints, strict=True) if speed}
    if wish.twist is not None:
        rates |= {
            axis_of(wish.hand, axis): rate for axis, rate in zip(HAND_AXES, wish.twist, strict=True) if rate
        }
    return OperatorCommand(rates, option=wish.option)


def axis_of(hand: str, axis: str) -> str:
    """The name of the commanded axis of a hand; without a hand, of all hands."""
    return f"{hand}.{axis}" if hand else axis


def check_grip(teleoperator: Teleoperator, grip: Grip, mode: DrivingMode) -> None:
    """Check that a robot can grip in a mode.

    Raises:
        ControllerError: it has one hand, or the mode would part the hands.
    """
    if mode not in (DrivingMode.POSE, DrivingMode.FOLLOW):
        teleoperator.check_grip(grip, ModeName(mode.value))
        return
    teleoperator.check_grip(grip, ModeName.COUPLED)  # one hand is one in any mode
    if grip is Grip.OBJECT:
        raise ControllerError(
            f"mode {mode.value} would part hands that hold an object; choose grip {Grip.FREE.value} first, "
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
