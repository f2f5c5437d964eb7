"""The interface behind keyboard, gamepad, SpaceMouse, master arm, script and options."""

from __future__ import annotations

import math
from types import TracebackType
from typing import Protocol, Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.driving import TELEOPERATION, DrivingMode, Frame, Grip, OperatorCommand


class OperatorInput(Protocol):
    """Source of an operator's commands; a context manager, since some hold a device."""

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time of the robot's clock [s]; empty while no input is touched, None at the end."""
        ...

    @property
    def status(self) -> str:
        """The present choice, for the operator."""
        return ""

    def reflect(self, share: float) -> None:
        """Let the operator's hand feel which fraction of the requested motion goes through, 0 to 1."""
        del share

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


# The dead zone of a stick or a cap: where it counts as let go.


DEAD_ZONE = 0.12
"""Deflection below which a stick counts as released; beyond it the speed grows from zero."""


def beyond_dead_zone(share: float) -> float:
    """Deflection from -1 to 1, zero in the dead zone and continuous at its edge."""
    beyond = (abs(share) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return math.copysign(min(1.0, beyond), share) if beyond > 0.0 else 0.0


# What a key or a button of an operator's device chooses next.


OBJECT = Grip.OBJECT.value
"""In the place of a hand's name: all hands, which hold one object."""
SPEED_STEP = 1.5
_LEAST_SPEED_M_S, _GREATEST_SPEED_M_S = 0.005, 0.5


def choices_help(
    *, mode: str, frame: str, hand: str, speed: str, end: str, outputs: str, on: str, off: str
) -> str:
    """The choices of every device, and the keys or buttons that make them."""
    return (
        f"{mode} next mode, {frame} world/tool, {hand} next hand, {speed} speed, {end} ends\n"
        f"outputs: {outputs} next, {on} on, {off} off"
    )


def next_mode(teleoperator: Teleoperator) -> DrivingMode:
    """The next mode after the present one that the robot supports."""
    modes = TELEOPERATION
    place = modes.index(teleoperator.mode)
    for offset in range(1, len(modes)):
        mode = modes[(place + offset) % len(modes)]
        try:
            teleoperator.mode_named(mode)
            teleoperator.check_grip(teleoperator.grip, mode)
        except ControllerError:
            continue  # this robot is not redundant, or holds an object
        return mode
    return teleoperator.mode


def next_hand(teleoperator: Teleoperator, hand: str | None) -> str | None:
    """The hand after this one; None is all of them, `OBJECT` all of them with an object between them."""
    hands: tuple[str | None, ...] = (None, *teleoperator.hand_names)
    if len(hands) > 2 and teleoperator.mode is not DrivingMode.JOINT:
        hands += (OBJECT,)
    return hands[(hands.index(hand) + 1) % len(hands)] if hand in hands else None


def grip_of(teleoperator: Teleoperator, hand: str | None) -> Grip | None:
    """The grip of a choice of hand; None for a robot with one hand."""
    if len(teleoperator.hand_names) < 2:
        return None
    return Grip.OBJECT if hand == OBJECT else Grip.FREE


def led_hand(hand: str | None) -> str:
    """The hand that a master leads for a choice of hand, as `OperatorCommand.led` has it."""
    return "" if hand in (None, OBJECT) else hand


def hand_axis(hand: str | None, axis: str) -> str:
    """The name of the commanded axis for a choice of hand."""
    return axis if hand in (None, OBJECT) else f"{hand}.{axis}"


def other_frame(teleoperator: Teleoperator) -> Frame:
    """The other frame: tool if hands move in world axes, and the reverse."""
    return Frame.WORLD if teleoperator.frame is Frame.TOOL else Frame.TOOL


def changed_speed(speed_m_s: float, is_faster: bool) -> float:
    """The next hand speed, up or down, within its bounds [m/s]."""
    factor = SPEED_STEP if is_faster else 1.0 / SPEED_STEP
    return min(_GREATEST_SPEED_M_S, max(_LEAST_SPEED_M_S, factor * speed_m_s))


class OutputChoice:
    """The choice of the digital output to switch.

    On and off are separate commands, so it does no harm to press one twice, or without knowing the output's value.

    Args:
        teleoperator: the teleoperator of the robot that has the outputs.

    Attributes:
        name: of the output; empty if the robot has none.
    """

    def __init__(self, teleoperator: Teleoperator) -> None:
        self._names = teleoperator.robot.description.outputs
        self.name = self._names[0] if self._names else ""

    def next(self) -> None:
        """Choose the one after it."""
        if self._names:
            self.name = self._names[(self._names.index(self.name) + 1) % len(self._names)]

    def switched(self, is_on: bool) -> dict[str, bool]:
        """The command that switches it; empty if the robot has none."""
        return {self.name: is_on} if self.name else {}
