"""A SpaceMouse moves the hand; everything else is chosen by keys of the terminal."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Self

from deltaq_controllers.modes.motion import ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.choices import hand_axis, next_hand
from deltaq_controllers.operator_input.interface import OperatorInput
from deltaq_controllers.operator_input.keyboard import TURN_RAD_M, Keyboard
from deltaq_controllers.operator_input.six_axis import SixAxis, SixAxisState
from deltaq_controllers.operator_input.spacemouse_device import SpaceMouseDevice

HELP = (
    "SpaceMouse: hold its left button to move, along and about all axes at once; right button: next hand\n"
    "in modes of joints pushing ahead drives the joint that is chosen; the keys below choose, and move as well"
)
RUN, NEXT_HAND = 0, 1
"""Buttons of the device."""


class SpaceMouse(OperatorInput):
    """Commands from a SpaceMouse, and from keys.

    Args:
        teleoperator: the robot that is driven.
        keyboard: chooses mode, axes, hand, joint, speed, options and outputs, and ends the drive.
    """

    def __init__(self, teleoperator: Teleoperator, keyboard: Keyboard) -> None:
        self._teleoperator, self._keyboard = teleoperator, keyboard
        self._device, self._cap = SpaceMouseDevice(), SixAxis()
        self._is_held = False
        self._entered = ExitStack()

    @property
    def status(self) -> str:
        """The present choice."""
        if not self._device.name:
            return f"{self._keyboard.status}, the SpaceMouse is unplugged"
        ignored = f", {self._cap.ignored} reports ignored" if self._cap.ignored else ""
        if not self._cap.is_armed:
            return f"{self._keyboard.status}, let the cap go: nothing moves until it was at rest{ignored}"
        return f"{self._keyboard.status}, {'held' if self._is_held else 'hold the left button'}{ignored}"

    @property
    def hand(self) -> str | None:
        """The hand that is moved, as the keyboard has it."""
        return self._keyboard.hand

    @property
    def is_clutched(self) -> bool:
        """Whether the left button is held, by which a master leads."""
        return self._is_held

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time [s]; None after the key that ends the drive. A device that is unplugged is rest."""
        command = self._keyboard.read(time_s)
        reports = self._device.read(time_s)
        if reports is None:
            self._cap.forget()
            self._is_held = False
            return command
        return self.moved(command, self._cap.look(reports, time_s))

    def moved(self, command: OperatorCommand | None, state: SixAxisState) -> OperatorCommand | None:
        """The keys' command together with the motion of the cap."""
        self._is_held = RUN in state.held
        for _ in range(state.pressed.count(NEXT_HAND)):
            self._keyboard.hand = next_hand(self._teleoperator, self._keyboard.hand)
        if command is None or not self._is_held:
            return command
        rates = {axis: rate for axis, rate in self._rates(state).items() if rate}
        return replace(command, rates=rates) if rates else command

    def _rates(self, state: SixAxisState) -> dict[str, float]:
        teleoperator, keyboard, speed_m_s = self._teleoperator, self._keyboard, self._keyboard.speed_m_s
        mode = teleoperator.mode
        if mode is ModeName.ADVISOR:
            return {}
        if teleoperator.mode_named(mode).drives_hands:
            return {
                hand_axis(keyboard.hand, axis): rate
                * speed_m_s
                * (TURN_RAD_M if axis.startswith("r") else 1.0)
                for axis, rate in state.rates.items()
            }
        axis, rate = keyboard.joint_rate(state.rates["x"])
        return {axis: rate}

    def __enter__(self) -> Self:
        """Find the device, and take keys.

        Raises:
            ControllerError: there is no device, or no terminal.
        """
        self._device.open()
        self._entered.callback(self._device.close)
        with self._entered:
            self._entered.enter_context(self._keyboard)
            self._entered = self._entered.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give both back."""
        self._entered.__exit__(kind, error, trace)
