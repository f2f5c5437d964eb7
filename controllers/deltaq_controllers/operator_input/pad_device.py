"""A gamepad as SDL knows it: its database of mappings gives sticks and buttons the same names on every pad.

A pad counts once every stick and trigger has been seen at rest since it was found. Until then its presses are told, for
the button that ends the drive, and nothing is held. Pads come and go while one looks.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import TracebackType
from typing import Any, Self

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.operator_input.dead_zone import beyond_dead_zone

PULLED, LET_GO = 0.7, 0.3
"""Way of a trigger from which on it is pulled, and below which it can be pulled again."""
RUMBLE_S = 0.4
"""A rumble that is not told again ends by itself after this, whatever becomes of the drive."""
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
    """How a pad stands.

    Attributes:
        sticks: deflection of each, from -1 to 1, 0 in the dead zone.
        held: buttons that are held, since a press that was seen.
        pressed: buttons that went down since the last look, in their order.
        pulled: triggers that were pulled since the last look.
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
        """How the pad stands at a time [s]; None while no pad is plugged in."""
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
