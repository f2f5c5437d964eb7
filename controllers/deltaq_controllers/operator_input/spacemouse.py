"""A SpaceMouse moves the hand; everything else is chosen by keys of the terminal."""

import struct
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import (
    OperatorInput,
    beyond_dead_zone,
    hand_axis,
    led_hand,
    next_hand,
)
from deltaq_controllers.operator_input.keyboard import TURN_RAD_M, Keyboard
from deltaq_protocol.driving import HAND_AXES, DrivingMode, OperatorCommand

# A 6-axis hand controller (SpaceMouse), from the bytes of its HID reports. Pure: times are handed in.
#
# Report 1 has the translation and report 2 the rotation, three little-endian 16-bit numbers each; on newer devices
# report 1 has both. Report 3 has a bit for each button. The device's own axes point right, to the operator, and down,
# and turns are right-handed about them. The cap reports again and again while it is deflected, and once when it is
# let go.


FULL = 350
"""Greatest deflection that a device reports."""
MOST = 3 * FULL
"""Greatest valid number of a deflection."""
SETTLE_S = 0.3
"""Time within which a newly found device reports a deflected cap [s]."""
STALE_S = 0.3
"""A deflection without a report for this time is not believed, since a radio link may be lost [s]."""

_TRANSLATION, _ROTATION, _BUTTONS = 1, 2, 3
_THREE, _SIX = struct.Struct("<3h"), struct.Struct("<6h")
_MOST_BUTTON_BYTES = 6
_PLACES = (1, 0, 2, 4, 3, 5)
"""Which number of the device is about each axis of a hand; all point the other way."""


@dataclass(frozen=True)
class SixAxisState:
    """State of a 6-axis controller.

    Attributes:
        rates: deflection along and about each axis of a hand, from -1 to 1; x is ahead, y left, z up.
        held: buttons that are held, counted from 0.
        pressed: buttons that went down since the last look, in their order.
    """

    rates: dict[str, float]
    held: frozenset[int] = frozenset()
    pressed: tuple[int, ...] = ()


class SixAxis:
    """Decodes the reports of a 6-axis controller. Deflections count only after every axis has been at rest.

    Attributes:
        ignored: reports that were malformed, or of a kind that says nothing of cap and buttons.
    """

    def __init__(self) -> None:
        self.ignored = 0
        self.forget()

    def forget(self) -> None:
        """Forget all values; the device was lost."""
        self._raw: list[int | None] = [0] * len(HAND_AXES)
        self._held: frozenset[int] = frozenset()
        self._let_go: set[int] = set()
        self._settled_s: float | None = None
        self._told_s = 0.0

    def look(self, reports: Iterable[bytes], time_s: float) -> SixAxisState:
        """Decode the reports received until a time [s]; returns the controller's state."""
        pressed: list[int] = []
        for report in reports:
            before = self._held
            if self._take(report):
                self._told_s = time_s
                pressed += sorted(self._held - before)
            else:
                self.ignored += 1
        if self._settled_s is None:
            self._settled_s = time_s + SETTLE_S
        if time_s < self._settled_s:
            self._held = frozenset()  # buttons held when the device is found are not meant for the robot
            return SixAxisState(dict.fromkeys(HAND_AXES, 0.0))
        if time_s - self._told_s > STALE_S and any(self._raw):
            self._let_go.clear()
            self._raw = [None if number else 0 for number in self._raw]
        return SixAxisState(self._rates(), self._held, tuple(pressed))

    @property
    def is_armed(self) -> bool:
        """Whether every axis was at rest since the device was found, or since it fell silent while it was deflected."""
        return len(self._let_go) == len(HAND_AXES)

    def _take(self, report: bytes) -> bool:
        """Whether a report was understood."""
        if not report:
            return False
        kind, data = report[0], report[1:]
        if kind == _TRANSLATION and len(data) == _SIX.size:
            return self._deflected(0, _SIX.unpack(data))
        if kind in (_TRANSLATION, _ROTATION) and len(data) == _THREE.size:
            return self._deflected(0 if kind == _TRANSLATION else 3, _THREE.unpack(data))
        if kind == _BUTTONS and 0 < len(data) <= _MOST_BUTTON_BYTES:
            bits = int.from_bytes(data, "little")
            self._held = frozenset(bit for bit in range(8 * len(data)) if bits >> bit & 1)
            return True
        return False

    def _deflected(self, first: int, numbers: tuple[int, ...]) -> bool:
        if max(map(abs, numbers)) > MOST:
            return False
        self._raw[first : first + len(numbers)] = numbers
        return True

    def _rates(self) -> dict[str, float]:
        rates = dict.fromkeys(HAND_AXES, 0.0)
        for axis, place in zip(HAND_AXES, _PLACES, strict=True):
            number = self._raw[place]
            if number is None:
                continue
            share = beyond_dead_zone(number / FULL)
            if not share:
                self._let_go.add(place)
            rates[axis] = -share
        return rates if self.is_armed else dict.fromkeys(HAND_AXES, 0.0)


# The reports of a SpaceMouse that is plugged in, through hidapi. The device comes and goes while one looks.


SEARCH_S = 1.0
"""Time between two searches for a device that was unplugged [s]: a search takes milliseconds."""

_MOST_REPORTS = 64
"""Read at a time: a device sends a few of them in a cycle, and one that floods does not keep the robot waiting."""
_REPORT_BYTES = 64

_MAKER = 0x256F
_MAKER_BEFORE = 0x046D
_PRODUCTS_BEFORE = frozenset(
    {0xC603, 0xC605, 0xC606, 0xC621, 0xC623, 0xC625, 0xC626, 0xC627, 0xC628, 0xC629, 0xC62B}
)
"""3Dconnexion's own number, and the devices that had Logitech's, which makes other devices too."""
_CONTROLLER, _UNKNOWN = (0x01, 0x08), (0, 0)
"""Usage of a multi-axis controller; not every backend of hidapi tells it."""


def is_spacemouse(found: dict[str, Any]) -> bool:
    """Whether a device of hidapi is the 6-axis interface of a SpaceMouse."""
    maker, product = found["vendor_id"], found["product_id"]
    is_made = maker == _MAKER or (maker == _MAKER_BEFORE and product in _PRODUCTS_BEFORE)
    return is_made and (found.get("usage_page", 0), found.get("usage", 0)) in (_CONTROLLER, _UNKNOWN)


class SpaceMouseDevice:
    """The first SpaceMouse that is plugged in.

    Attributes:
        name: of the device; empty while there is none.
    """

    def __init__(self) -> None:
        self.name = ""
        self._hid: Any = None
        self._device: Any = None
        self._search_s = 0.0

    def open(self) -> None:
        """Find and open a device.

        Raises:
            ControllerError: hidapi is not installed, no device is plugged in, or it may not be read.
        """
        try:
            import hid
        except ImportError:
            raise ControllerError(
                "a SpaceMouse needs hidapi, which comes with `pip install 'deltaq[all]'`"
            ) from None
        self._hid = hid
        found = [one for one in hid.enumerate() if is_spacemouse(one)]
        if not found:
            raise ControllerError(
                "no SpaceMouse is plugged in, or this user may not see it; plug one in, "
                "or choose `--input keyboard` or `--input gamepad`"
            )
        if not self._open(found):
            name = found[0].get("product_string") or "the SpaceMouse"
            raise ControllerError(
                f"{name} cannot be opened: on Linux a rule of udev lets this user read it, "
                "and no other program may hold it"
            )

    def read(self, time_s: float) -> list[bytes] | None:
        """The reports received since the last call, at a time [s]; None while no device is plugged in."""
        if self._device is None and not self._search(time_s):
            return None
        reports: list[bytes] = []
        try:
            while len(reports) < _MOST_REPORTS and (report := self._device.read(_REPORT_BYTES)):
                reports.append(bytes(report))
        except (OSError, ValueError):  # unplugged
            self.close()
            return None
        return reports

    def close(self) -> None:
        """Close the device."""
        if self._device is not None:
            self._device.close()
        self._device, self.name = None, ""

    def _search(self, time_s: float) -> bool:
        if time_s < self._search_s:
            return False
        self._search_s = time_s + SEARCH_S
        return self._open([one for one in self._hid.enumerate() if is_spacemouse(one)])

    def _open(self, found: list[dict[str, Any]]) -> bool:
        for one in found:
            device = self._hid.device()
            try:
                device.open_path(one["path"])
                device.set_nonblocking(True)
            except (OSError, ValueError):
                continue
            self._device, self.name = device, one.get("product_string") or "SpaceMouse"
            return True
        return False


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
            return f"{self._keyboard.status}, release the cap: nothing moves until it was at rest{ignored}"
        return f"{self._keyboard.status}, {'held' if self._is_held else 'hold the left button'}{ignored}"

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command at a time [s]; None after the key that ends the drive. An unplugged device means rest."""
        command = self._keyboard.read(time_s)
        reports = self._device.read(time_s)
        if reports is None:
            self._cap.forget()
            self._is_held = False
            return command and replace(command, led=None)
        return self.moved(command, self._cap.look(reports, time_s))

    def moved(self, command: OperatorCommand | None, state: SixAxisState) -> OperatorCommand | None:
        """The keys' command together with the motion of the cap."""
        self._is_held = RUN in state.held
        for _ in range(state.pressed.count(NEXT_HAND)):
            self._keyboard.hand = next_hand(self._teleoperator, self._keyboard.hand)
        if command is None or not self._is_held:
            return command and replace(command, led=None)
        rates = {axis: rate for axis, rate in self._rates(state).items() if rate}
        return replace(command, rates=rates or command.rates, led=led_hand(self._keyboard.hand))

    def _rates(self, state: SixAxisState) -> dict[str, float]:
        teleoperator, keyboard, speed_m_s = self._teleoperator, self._keyboard, self._keyboard.speed_m_s
        mode = teleoperator.mode
        if mode is DrivingMode.ADVISOR:
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

    def __exit__(self, *_: object) -> None:
        """Give both back."""
        self._entered.close()
