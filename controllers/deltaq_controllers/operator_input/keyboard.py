"""The keyboard of a terminal as an operator's stick.

A tap moves a little, a held key moves until shortly after it is let go (`deltaq_controllers.operator_input.keyboard`):
hands off is rest.
"""

import os
import select
import sys
import termios
import tty
from contextlib import suppress
from typing import Any, Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import (
    OperatorInput,
    OutputChoice,
    changed_speed,
    choices_help,
    grip_of,
    hand_axis,
    led_hand,
    next_hand,
    next_mode,
    other_frame,
)
from deltaq_protocol.driving import DrivingMode, OperatorCommand

# Whether a key is tapped or held, from a terminal that reports presses and repeats alike and no release.
#
# A held key is repeated after a first delay of 0.25 to 0.66 s and then some 10 to 30 times a second, as the
# operator's desktop is set. So the first press moves slowly for as long as that delay may take, and the key counts as
# held from the second repeat on: then it moves at full speed, and stops soon after the last repeat.


FIRST_REPEAT_S = 0.7
"""Longest time from a press to its first repeat."""

HOLD_S = 0.2
"""Duration of the motion after a key's repeat: the longest full speed after its release, before the robot brakes."""

TAP_S = 0.1
"""A tap moves as far as full speed does in this time."""

TAP_SHARE = TAP_S / FIRST_REPEAT_S
"""Fraction of the speed until a key counts as held."""

_HELD_FROM = 3
"""The press, its first repeat, and the next one: two taps are no hold."""


class HeldKey:
    """The key pressed last, and how fast it moves."""

    def __init__(self) -> None:
        self._key = ""
        self._presses = 0
        self._until_s = 0.0

    def press(self, key: str, time_s: float) -> None:
        """A press or a repeat of a key at a time [s]."""
        is_repeat = key == self._key and time_s < self._until_s
        self._presses = self._presses + 1 if is_repeat else 1
        self._key, self._until_s = key, time_s + (HOLD_S if is_repeat else FIRST_REPEAT_S)

    def release(self) -> None:
        """Release the key that is held."""
        self._key, self._presses = "", 0

    def share(self, time_s: float) -> float:
        """Fraction of the full speed at a time [s]; 0 is rest."""
        if not self._presses or time_s >= self._until_s:
            return 0.0
        return 1.0 if self._presses >= _HELD_FROM else TAP_SHARE


HAND_KEYS = {
    "w": ("x", 1), "s": ("x", -1), "a": ("y", 1), "d": ("y", -1), "r": ("z", 1), "f": ("z", -1),
    "i": ("ry", 1), "k": ("ry", -1), "j": ("rx", -1), "l": ("rx", 1), "u": ("rz", 1), "o": ("rz", -1),
}  # fmt: skip
"""Key to axis of the hand and direction."""

HELP = (
    f"{choices_help(mode='m', frame='t', hand='h', speed='+/-', end='q', outputs='g', on='.', off=',')}\n"
    "hand: w/s x, a/d y, r/f z, j/l rx, i/k ry, u/o rz; joints: arrows up/down drive, left/right choose\n"
    f"a tap moves as far as full speed does in {TAP_S:g} s; a held key moves slowly until it repeats, then at full\n"
    f"speed until {HOLD_S:g} s after its last repeat; space stops\n"
    "1-9 go to an option of the advisor, any other key stops"
)

OPTION_KEYS = "123456789"
"""Keys of the advisor's options; a choice holds until another key is pressed."""

_ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}
TURN_RAD_M = 3.5
"""Turning rate for a m/s of hand speed [rad/m]."""
_SWITCH_KEYS = {".": True, ",": False}


class Keyboard(OperatorInput):
    """Commands from key presses.

    Args:
        teleoperator: the robot that is driven; tells its joints, hands and mode.
        file: descriptor of the terminal.
        speed_m_s: hand speed to begin with; other rates follow from it.

    Attributes:
        joint: the joint that the arrows drive.
        hand: the hand that the keys move; None for all, `object` for an object that all hold.
        output: the digital output that the keys switch.
        speed_m_s: hand speed now.
    """

    def __init__(self, teleoperator: Teleoperator, file: int | None = None, speed_m_s: float = 0.1) -> None:
        self._teleoperator = teleoperator
        self._file = sys.stdin.fileno() if file is None else file
        self.speed_m_s = speed_m_s
        self._held = HeldKey()
        self._option: int | None = None
        self._rates: dict[str, float] = {}
        self._saved: list[Any] | None = None
        self._text = ""
        self.joint = 0
        self.hand: str | None = None
        self.output = OutputChoice(teleoperator)
        self._is_clutched = False

    @property
    def status(self) -> str:
        """The present choice."""
        name = self._teleoperator.robot.joint_names[self.joint]
        chosen = f"joint {name}, hand {self.hand or 'all'}, {self.speed_m_s:.3f} m/s"
        return f"{chosen}, output {self.output.name}" if self.output.name else chosen

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command from the keys pressed since the last call; None after q or at the end of the input."""
        mode, frame = None, None
        outputs: dict[str, bool] = {}
        for key in self._keys():
            if key in ("q", ""):
                return None
            self._option = int(key) if key in OPTION_KEYS else None
            self._is_clutched = key == "c"  # and no other key since: a master leads
            if key == "m":
                mode = next_mode(self._teleoperator)
            elif key == "t":
                frame = other_frame(self._teleoperator)
            elif key == "h":
                self._held.release()  # the key was held for another motion
                self.hand = next_hand(self._teleoperator, self.hand)
            elif key == "g":
                self.output.next()
            elif key in _SWITCH_KEYS:
                self._held.release()  # a held key does not move an object that was just gripped or released
                outputs |= self.output.switched(_SWITCH_KEYS[key])
            elif key in "+-":
                self.speed_m_s = changed_speed(self.speed_m_s, is_faster=key == "+")
            elif key in ("left", "right"):
                self.joint = (self.joint + (1 if key == "right" else -1)) % self._teleoperator.robot.n
            elif key in ("up", "down"):
                self._press(key, time_s, *self.joint_rate(1.0 if key == "up" else -1.0))
            elif key in HAND_KEYS:
                axis, sign = HAND_KEYS[key]
                rate = sign * self.speed_m_s * (TURN_RAD_M if axis.startswith("r") else 1.0)
                self._press(key, time_s, hand_axis(self.hand, axis), rate)
            else:
                self._held.release()
        share = self._held.share(time_s)
        rates = {axis: share * rate for axis, rate in self._rates.items()} if share else {}
        option = self._option if self._teleoperator.mode is DrivingMode.ADVISOR else None
        grip = grip_of(self._teleoperator, self.hand)
        led = led_hand(self.hand) if self._is_clutched else None
        return OperatorCommand(rates, mode, frame, option, outputs, grip, led)

    def _press(self, key: str, time_s: float, axis: str, rate: float) -> None:
        self._held.press(key, time_s)
        self._rates = {axis: rate}

    def joint_rate(self, sign: float) -> tuple[str, float]:
        """The chosen joint, and its rate at a fraction of full speed, -1 to 1 [rad/s or m/s]."""
        robot = self._teleoperator.robot
        factor = TURN_RAD_M if robot.revolute[self.joint] else 1.0
        return robot.joint_names[self.joint], sign * factor * self.speed_m_s

    def _keys(self) -> list[str]:
        """Keys pressed, arrows by name; an empty one is the end of the input."""
        while select.select([self._file], [], [], 0.0)[0]:
            try:
                data = os.read(self._file, 256)
            except OSError:  # the terminal was closed
                data = b""
            if not data:
                return [""]
            self._text += data.decode("utf-8", "replace")
        keys = []
        while self._text:
            if self._text.startswith("\x1b"):
                if len(self._text) < 3 and "\x1b[".startswith(self._text):
                    break  # the rest of the sequence follows
                keys.append(_ARROWS.get(self._text[:3], " "))
                self._text = self._text[3:]
            else:
                keys.append(self._text[0])
                self._text = self._text[1:]
        return keys

    def __enter__(self) -> Self:
        """Take single keys from the terminal, without echo.

        Raises:
            ControllerError: there is no terminal.
        """
        try:
            self._saved = termios.tcgetattr(self._file)
        except termios.error:
            raise ControllerError(
                "the keyboard needs a terminal; from a pipe use a script (`--script`)"
            ) from None
        tty.setcbreak(self._file)
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal, and drop unread keys: they are not for the shell."""
        if self._saved is not None:
            with suppress(termios.error):  # the terminal was closed
                # not TCSADRAIN, which would wait for output that was stopped by Ctrl-S
                termios.tcsetattr(self._file, termios.TCSANOW, self._saved)
                termios.tcflush(self._file, termios.TCIFLUSH)
