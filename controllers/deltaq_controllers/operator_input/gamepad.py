"""A gamepad as an operator's stick, laid out as in the console, by `deltaq_protocol.pad_layout`.

The sticks count only while a shoulder button is held. An unplugged pad means rest; it works again when plugged in.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import (
    AskedViewDistance,
    OperatorInput,
    OutputChoice,
    beyond_dead_zone,
    changed_speed,
    grip_of,
    hand_axis,
    led_hand,
    next_hand,
    next_mode,
    other_frame,
)
from deltaq_controllers.operator_input.keyboard import TURN_RAD_M
from deltaq_protocol.driving import DrivingMode, Frame, OperatorCommand
from deltaq_protocol.pad_layout import PAD_LAYOUT, VIEW_STEP_M, PadFunction

# A gamepad as SDL knows it: its database of mappings gives sticks and buttons the same names on every pad.
#
# A pad counts once every stick and trigger has been seen at rest since it was found. Until then only its presses are
# reported, for the button that ends the drive. Pads may be plugged in and out at any time.


PULLED, LET_GO = 0.7, 0.3
"""Way of a trigger from which on it is pulled, and below which it can be pulled again."""
RUMBLE_S = 0.4
"""A rumble ends after this time unless it is renewed, also if the drive ends."""
_LEVELS = 8
SETTLE_S = 0.3
"""A pad that was found tells how its buttons and sticks stand within this."""
_FULL = 32767.0

_SETTINGS = {
    "SDL_VIDEODRIVER": "dummy",  # events without a window
    "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",
    "SDL_NO_SIGNAL_HANDLERS": "1",  # Ctrl-C is the drive's
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
}


class StickAxis(IntEnum):
    """Axes of the sticks as SDL counts them; positive is right and back."""

    LEFT_X = 0
    LEFT_Y = 1
    RIGHT_X = 2
    RIGHT_Y = 3


class Trigger(IntEnum):
    """The triggers below the shoulder buttons, as SDL counts their axes."""

    LEFT = 4
    RIGHT = 5


class PadButton(IntEnum):
    """Buttons as SDL counts them, by their places on a pad."""

    A = 0
    B = 1
    X = 2
    Y = 3
    BACK = 4
    START = 6
    LEFT_STICK = 7
    LEFT_SHOULDER = 9
    RIGHT_SHOULDER = 10
    UP = 11
    DOWN = 12
    LEFT = 13
    RIGHT = 14


@dataclass(frozen=True)
class PadState:
    """The state of a pad.

    Attributes:
        sticks: deflection of each, from -1 to 1, 0 in the dead zone.
        held: buttons that are held, since a press that was seen.
        pressed: buttons pressed since the last poll, in their order.
        pulled: triggers pulled since the last poll.
        waits_for: sticks and triggers that were not seen at rest yet, in words; the pad counts once there are none.
    """

    sticks: Mapping[StickAxis, float]
    held: frozenset[PadButton] = frozenset()
    pressed: tuple[PadButton, ...] = ()
    pulled: tuple[Trigger, ...] = ()
    waits_for: tuple[str, ...] = ()


class PadDevice:
    """The first gamepad that is plugged in; a context manager that holds SDL.

    Attributes:
        name: of the pad; empty while there is none.
    """

    def __init__(self) -> None:
        self.name = ""
        self._pygame: Any = None
        self._controller: Any = None
        self._pad: Any = None
        self._instance = -1
        self._settled_s: float | None = None
        self._held: set[PadButton] = set()
        self._stirred: set[StickAxis | Trigger] = set()
        self._ready: set[Trigger] = set()
        self._is_rumbling = False

    def look(self, time_s: float) -> PadState | None:
        """State of the gamepad at a time [s]; None while no pad is plugged in."""
        events = self._pygame.event.get()
        if self._pad is not None and not self._pad.attached():
            self._lose()
        if self._pad is None and not self._find():
            return None
        if self._settled_s is None:
            self._settled_s = time_s + SETTLE_S
        if time_s < self._settled_s:
            return PadState(dict.fromkeys(StickAxis, 0.0))
        sticks, (held, pressed), pulled = self._sticks(), self._buttons(events), self._pulled()
        self._stirred -= {stick for stick, share in sticks.items() if not share} | self._ready
        if self._stirred:
            self._held.clear()
            waits_for = tuple(
                f"{axis.name.lower()}{'_trigger' * isinstance(axis, Trigger)}".replace("_", " ")
                for axis in sorted(self._stirred)
            )
            return PadState(dict.fromkeys(StickAxis, 0.0), pressed=pressed, waits_for=waits_for)
        return PadState(sticks, held, pressed, pulled)

    def rumble(self, strength: float) -> None:
        """Have the pad rumble, 0 to 1, until the next call; no effect on a pad that cannot rumble."""
        level = round(_LEVELS * strength) / _LEVELS
        if self._pad is None or not (level or self._is_rumbling):
            return
        self._is_rumbling = level > 0.0
        # SDL sends it on only if it changes
        self._pad.rumble(level, 0.0, round(1000 * RUMBLE_S))

    def _sticks(self) -> dict[StickAxis, float]:
        return {stick: beyond_dead_zone(self._pad.get_axis(stick) / _FULL) for stick in StickAxis}

    def _pulled(self) -> tuple[Trigger, ...]:
        shares = {trigger: self._pad.get_axis(trigger) / _FULL for trigger in Trigger}
        pulled = tuple(trigger for trigger in Trigger if trigger in self._ready and shares[trigger] > PULLED)
        self._ready -= set(pulled)
        self._ready |= {trigger for trigger in Trigger if shares[trigger] < LET_GO}
        return pulled

    def _buttons(self, events: list[Any]) -> tuple[frozenset[PadButton], tuple[PadButton, ...]]:
        downs = [
            PadButton(event.button)
            for event in events
            if event.type == self._pygame.CONTROLLERBUTTONDOWN
            and event.instance_id == self._instance
            and event.button in set(PadButton)
        ]
        self._held = {button for button in self._held | set(downs) if self._pad.get_button(button)}
        return frozenset(self._held), tuple(downs)

    def _find(self) -> bool:
        for index in range(self._controller.get_count()):
            if self._controller.is_controller(index):
                self._pad = self._controller.Controller(index)
                self._instance = self._pad.as_joystick().get_instance_id()
                self.name = self._pad.name
                self._stirred = {*StickAxis, *Trigger}
                return True
        return False

    def _lose(self) -> None:
        self._pad.quit()
        self._pad, self.name, self._settled_s = None, "", None
        self._held.clear()
        self._ready.clear()
        self._is_rumbling = False

    def __enter__(self) -> Self:
        """Find a pad.

        Raises:
            ControllerError: SDL is not installed, or no gamepad is plugged in.
        """
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        try:
            import pygame
            from pygame._sdl2 import controller
        except ImportError:
            raise ControllerError(
                "a gamepad needs pygame-ce, which comes with `pip install 'deltaq[all]'`"
            ) from None
        pygame.display.init()
        controller.init()
        self._pygame, self._controller = pygame, controller
        pygame.event.get()
        if not self._find():
            pygame.joystick.init()
            others = [pygame.joystick.Joystick(index).get_name() for index in range(controller.get_count())]
            self._close()
            raise ControllerError(_nothing_found(others))
        return self

    def __exit__(self, *_: object) -> None:
        """Give SDL back."""
        self._close()

    def _close(self) -> None:
        if self._pad is not None:
            self.rumble(0.0)
            self._lose()
        self._controller.quit()
        self._pygame.display.quit()


def _nothing_found(others: list[str]) -> str:
    if others:
        return (
            f"{', '.join(others)}: not used, since SDL has no mapping for it; "
            "set SDL_GAMECONTROLLERCONFIG, or use the keyboard or `--script`"
        )
    return "no gamepad is plugged in, or this user may not read it; plug one in, or use the keyboard or `--script`"


HELP = (
    "hold the left shoulder button to move, the right one to turn: left stick x and y, right stick z\n"
    "Y next mode, X world/tool, A next hand, B ends; start next output, right trigger on, left trigger off\n"
    "D-pad up/down: view nearer, farther; left/right: slower, faster, in modes of joints or options the next of them"
)

_AXES = {
    PadButton.LEFT_SHOULDER: {StickAxis.LEFT_Y: "x", StickAxis.LEFT_X: "y", StickAxis.RIGHT_Y: "z"},
    PadButton.RIGHT_SHOULDER: {StickAxis.LEFT_Y: "rx", StickAxis.LEFT_X: "ry", StickAxis.RIGHT_Y: "rz"},
}
"""Axes of the hand that the sticks move while a button is held; a stick pushed ahead or left is positive."""
_NAMES = {control.name: control.function for control in PAD_LAYOUT}
BUTTONS = {button: _NAMES[button.name.lower()] for button in PadButton}
"""What each button does; `PadFunction.ROBOT` and `PadFunction.PICTURE` do nothing here."""
TRIGGERS = {trigger: _NAMES[f"{trigger.name.lower()}_trigger"] for trigger in Trigger}
"""What each trigger does."""
_OPTIONS = 9
_PUSHED = 0.5


class Gamepad(OperatorInput):
    """Commands from a gamepad.

    In a mode that drives joints alone the left stick drives the joint chosen, in advisor mode it goes to the option
    chosen while it is pushed ahead; otherwise the sticks move the hand.

    Args:
        teleoperator: the robot that is driven.
        speed_m_s: hand speed at full deflection to begin with; other rates follow from it.
        view: of the camera that watches the robot; None where none does.

    Attributes:
        joint: the joint that the stick drives.
        option: the advisor's option that it goes to.
        hand: the hand that the sticks move; None for all, `object` for an object that all hold.
        output: the digital output that the triggers switch.
    """

    def __init__(
        self, teleoperator: Teleoperator, speed_m_s: float = 0.1, view: AskedViewDistance | None = None
    ) -> None:
        self._teleoperator, self._view = teleoperator, view
        self._device = PadDevice()
        self._speed_m_s = speed_m_s
        self._held: frozenset[PadButton] = frozenset()
        self._waits_for: tuple[str, ...] = ()
        self.joint = 0
        self.option = 1
        self.hand: str | None = None
        self.output = OutputChoice(teleoperator)

    @property
    def status(self) -> str:
        """The present choice."""
        if not self._device.name:
            return "the gamepad is unplugged: rest"
        if self._waits_for:
            return f"let go of {', '.join(self._waits_for)}: nothing moves until each was at rest; B ends"
        if self._is_advised:
            chosen = f"option {self.option}"
        elif self._is_by_hand:
            chosen = f"hand {self.hand or 'all'}"
        else:
            chosen = f"joint {self._teleoperator.robot.joint_names[self.joint]}"
        if self.output.name:
            chosen += f", output {self.output.name}"
        held = "held" if self._holding else "hold a shoulder button to move"
        seen = f", {self._view.status}" if self._view is not None and self._view.status else ""
        return f"{chosen}, {self._speed_m_s:.3f} m/s{seen}, {held}"

    @property
    def _is_advised(self) -> bool:
        return self._teleoperator.mode is DrivingMode.ADVISOR

    @property
    def _is_by_hand(self) -> bool:
        return self._teleoperator.mode_named(self._teleoperator.mode).drives_hands

    @property
    def _holding(self) -> PadButton | None:
        return next((button for button in _AXES if button in self._held), None)

    def read(self, time_s: float) -> OperatorCommand | None:
        """The command from where sticks and buttons stand at a time [s]; None after a button that ends the drive."""
        state = self._device.look(time_s)
        if state is None:
            self._held = frozenset()
            return OperatorCommand()
        self._held, self._waits_for = state.held, state.waits_for
        mode: DrivingMode | None = None
        frame: Frame | None = None
        for button in state.pressed:
            match BUTTONS[button]:
                case PadFunction.STOP:
                    return None
                case _ if state.waits_for:
                    continue
                case PadFunction.MODE:
                    mode = next_mode(self._teleoperator)
                case PadFunction.FRAME:
                    frame = other_frame(self._teleoperator)
                case chosen:
                    self._choose(chosen)
        outputs = self.output.switched(TRIGGERS[state.pulled[-1]] is PadFunction.ON) if state.pulled else {}
        grip = grip_of(self._teleoperator, self.hand)
        led = led_hand(self.hand) if self._holding is not None else None
        if self._is_advised:
            goes = self._holding is not None and state.sticks[StickAxis.LEFT_Y] < -_PUSHED
            return OperatorCommand({}, mode, frame, self.option if goes else None, outputs, grip, led)
        return OperatorCommand(self._rates(state), mode, frame, None, outputs, grip, led)

    def reflect(self, share: float) -> None:
        """Let the hand feel which fraction of the requested motion goes through: the less, the stronger."""
        self._device.rumble(1.0 - share)

    def _choose(self, function: PadFunction) -> None:
        match function:
            case PadFunction.HAND:
                self.hand = next_hand(self._teleoperator, self.hand)
            case PadFunction.OUTPUT:
                self.output.next()
            case PadFunction.NEARER | PadFunction.FARTHER:
                if self._view is not None:
                    self._view.change(-VIEW_STEP_M if function is PadFunction.NEARER else VIEW_STEP_M)
            case PadFunction.PREVIOUS | PadFunction.NEXT:
                self._step(1 if function is PadFunction.NEXT else -1)

    def _step(self, step: int) -> None:
        """Select the next option, joint, or speed of the hand, by mode."""
        if self._is_advised:
            self.option = (self.option - 1 + step) % _OPTIONS + 1
        elif self._is_by_hand:
            self._speed_m_s = changed_speed(self._speed_m_s, is_faster=step > 0)
        else:
            self.joint = (self.joint + step) % self._teleoperator.robot.n

    def _rates(self, state: PadState) -> dict[str, float]:
        holding = self._holding
        if holding is None:
            return {}
        if not self._is_by_hand:
            robot = self._teleoperator.robot
            factor = TURN_RAD_M if robot.revolute[self.joint] else 1.0
            return {robot.joint_names[self.joint]: -factor * self._speed_m_s * state.sticks[StickAxis.LEFT_Y]}
        factor = TURN_RAD_M if holding is PadButton.RIGHT_SHOULDER else 1.0
        return {
            hand_axis(self.hand, axis): -factor * self._speed_m_s * state.sticks[stick]
            for stick, axis in _AXES[holding].items()
        }

    def __enter__(self) -> Self:
        """Find the gamepad.

        Raises:
            ControllerError: there is none.
        """
        self._device.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        """Give the device back."""
        self._device.__exit__()
