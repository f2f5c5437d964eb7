"""A gamepad that is none: SDL's virtual joystick, plugged in and out and moved as a hand would."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import TracebackType
from typing import Self

_JOYSTICK, _GAMECONTROLLER = 0x200, 1
_AXES, _BUTTONS = 6, 15


def _sdl() -> ctypes.CDLL:
    """The SDL that pygame-ce has loaded into this process."""
    import pygame  # noqa: F401 -- loads it

    lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    library = ctypes.CDLL(next(line.split()[-1] for line in lines if "libSDL2-" in line))
    library.SDL_JoystickOpen.restype = ctypes.c_void_p
    library.SDL_GetError.restype = ctypes.c_char_p
    return library


class VirtualPad:
    """A gamepad that is plugged in for the length of the block, or as long as it is not pulled out."""

    def __init__(self) -> None:
        self._sdl = _sdl()
        self._pad: ctypes.c_void_p | None = None
        self._index = -1

    def plug_in(self) -> None:
        self._index = self._sdl.SDL_JoystickAttachVirtual(_GAMECONTROLLER, _AXES, _BUTTONS, 0)
        assert self._index >= 0, self._sdl.SDL_GetError()
        self._pad = ctypes.c_void_p(self._sdl.SDL_JoystickOpen(self._index))

    def pull_out(self) -> None:
        assert self._sdl.SDL_JoystickDetachVirtual(self._index) == 0, self._sdl.SDL_GetError()
        self._sdl.SDL_JoystickClose(self._pad)
        self._pad = None

    def push(self, axis: int, share: float) -> None:
        assert self._sdl.SDL_JoystickSetVirtualAxis(self._pad, axis, round(32767 * share)) == 0

    def pull(self, axis: int, share: float) -> None:
        # a trigger's way is all of its axis
        assert self._sdl.SDL_JoystickSetVirtualAxis(self._pad, axis, round(65535 * share) - 32768) == 0

    def press(self, *buttons: int) -> None:
        for button in buttons:
            assert self._sdl.SDL_JoystickSetVirtualButton(self._pad, button, 1) == 0
        self._sdl.SDL_JoystickUpdate()

    def release(self, *buttons: int) -> None:
        for button in buttons:
            assert self._sdl.SDL_JoystickSetVirtualButton(self._pad, button, 0) == 0
        self._sdl.SDL_JoystickUpdate()

    def __enter__(self) -> Self:
        assert self._sdl.SDL_InitSubSystem(_JOYSTICK) == 0, self._sdl.SDL_GetError()
        self.plug_in()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pad is not None:
            self.pull_out()
        self._sdl.SDL_QuitSubSystem(_JOYSTICK)
