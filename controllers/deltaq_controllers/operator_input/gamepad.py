"""A gamepad as an operator's stick, read from Linux' joystick device.

The device gives 8 bytes an event: time, value, type, number (Linux, Documentation/input/joydev). The sticks count
only while a shoulder button is held; an unplugged device ends the drive.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.motion import ModeName, OperatorCommand
from deltaq_controllers.modes.teleoperator import Teleoperator

DEVICE = Path("/dev/input/js0")

_EVENT = struct.Struct("=IhBB")
_BUTTON, _AXIS, _INITIAL = 0x01, 0x02, 0x80
_FULL = 32767.0
_DEAD_ZONE = 0.1
"""Deflection below which a stick counts as let go; from there on speed grows from zero."""
_TURN_RAD_M = 3.5

STICKS: Mapping[int, tuple[str, float]] = {
    0: ("y", -1.0), 1: ("x", -1.0), 3: ("rz", -1.0), 4: ("z", -1.0), 6: ("rx", 1.0), 7: ("ry", -1.0),
}  # fmt: skip
"""Number of a stick's axis, as common pads count them, to axis of the hand and direction."""

HOLD_BUTTONS = (4, 5)
"""Shoulder buttons: one of them must be held."""

MODE_BUTTONS: Mapping[int, ModeName] = {
    0: ModeName.COUPLED,
    1: ModeName.DECOUPLED,
    2: ModeName.SELF_MOTION,
    3: ModeName.JOINT,
    9: ModeName.ADVISOR,
}
"""Face buttons, and the left stick pressed."""

NEXT_BUTTON, QUIT_BUTTON = 7, 6
"""Start chooses the next joint, or the next option of the advisor; back ends."""

_OPTIONS = 9
_PUSHED = 0.5


class Gamepad:
    """Commands from a gamepad.

    In a mode that drives joints alone the left stick drives the joint chosen, in advisor mode it goes to the option
    chosen while it is pushed ahead; otherwise the sticks move the hand.

    Args:
        teleoperator: the robot that is driven.
        device: path of the joystick device.
        speed_m_s: hand speed at full deflection; other rates follow from it.
    """

    def __init__(self, teleoperator: Teleoperator, device: Path = DEVICE, speed_m_s: float = 0.1) -> None:
        self._teleoperator = teleoperator
        self._device = device
        self._speed_m_s = speed_m_s
        self._file: int | None = None
        self._sticks: dict[int, float] = {}
        self._held: set[int] = set()
        self.joint = 0
        self.option = 1

    @property
    def status(self) -> str:
        """The present choice."""
        joint = f"joint {self._teleoperator.robot.joint_names[self.joint]}"
        chosen = f"option {self.option}" if self._is_advised else joint
        return f"{chosen}, {'held' if self._is_held else 'hold a shoulder button to move'}"

    @property
    def _is_advised(self) -> bool:
        return self._teleoperator.mode is ModeName.ADVISOR

    @property
    def _is_held(self) -> bool:
        return bool(self._held & set(HOLD_BUTTONS))

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command from where sticks and buttons stand; None after the back button or when the device is gone."""
        del time_s  # a device tells every change
        try:
            pressed = self._take_events()
        except OSError:
            return None
        if QUIT_BUTTON in pressed:
            return None
        if NEXT_BUTTON in pressed and self._is_advised:
            self.option = self.option % _OPTIONS + 1
        elif NEXT_BUTTON in pressed:
            self.joint = (self.joint + 1) % self._teleoperator.robot.n
        mode = next((MODE_BUTTONS[button] for button in pressed if button in MODE_BUTTONS), None)
        if self._is_advised:
            goes = self._is_held and self._sticks.get(1, 0.0) < -_PUSHED
            return OperatorCommand({}, self._possible(mode), option=self.option if goes else None)
        return OperatorCommand(self._rates() if self._is_held else {}, self._possible(mode))

    def _possible(self, mode: ModeName | None) -> ModeName | None:
        try:
            return mode and self._teleoperator.mode_named(mode).name
        except ControllerError:
            return None  # this robot is not redundant

    def _rates(self) -> dict[str, float]:
        driver = self._teleoperator.mode_named(self._teleoperator.mode)
        if not driver.drives_hands:
            robot = self._teleoperator.robot
            factor = _TURN_RAD_M if robot.revolute[self.joint] else 1.0
            return {robot.joint_names[self.joint]: -factor * self._speed_m_s * self._sticks.get(1, 0.0)}
        rates = {}
        for stick, (axis, sign) in STICKS.items():
            factor = _TURN_RAD_M if axis.startswith("r") else 1.0
            rates[axis] = sign * factor * self._speed_m_s * self._sticks.get(stick, 0.0)
        return rates

    def _take_events(self) -> list[int]:
        """Read all waiting events; returns the buttons pressed.

        Raises:
            OSError: the device is gone.
        """
        assert self._file is not None  # within the block
        pressed: list[int] = []
        while True:
            try:
                data = os.read(self._file, _EVENT.size)
            except BlockingIOError:
                return pressed
            if len(data) < _EVENT.size:
                raise OSError("the device ended")
            _, value, kind, number = _EVENT.unpack(data)
            if kind & _AXIS:
                self._sticks[number] = _beyond_dead_zone(value / _FULL)
            elif kind & _BUTTON and value:
                if not kind & _INITIAL:  # a button held since before the drive was not pressed for it
                    self._held.add(number)
                    pressed.append(number)
            elif kind & _BUTTON:
                self._held.discard(number)

    def __enter__(self) -> Self:
        """Open the device.

        Raises:
            ControllerError: there is none.
        """
        try:
            self._file = os.open(self._device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise ControllerError(
                f"no gamepad at {self._device}: {error.strerror}; plug one in, or use the keyboard or `--script`"
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the device."""
        if self._file is not None:
            os.close(self._file)


def _beyond_dead_zone(share: float) -> float:
    """Deflection from -1 to 1, zero in the dead zone and continuous at its edge."""
    beyond = (abs(share) - _DEAD_ZONE) / (1.0 - _DEAD_ZONE)
    return math.copysign(min(1.0, beyond), share) if beyond > 0.0 else 0.0
