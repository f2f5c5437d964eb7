"""A gamepad that is none: SDL's virtual joystick, plugged in and out and moved as a hand would."""

import ctypes
from pathlib import Path
from types import TracebackType
from typing import Self

_Rumble = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_uint16, ctypes.c_uint16)


class _Description(ctypes.Structure):
    """SDL_VirtualJoystickDesc, version 1."""

    _fields_ = (
        *((name, ctypes.c_uint16) for name in ("version", "type", "naxes", "nbuttons", "nhats")),
        *((name, ctypes.c_uint16) for name in ("vendor_id", "product_id", "padding")),
        *((name, ctypes.c_uint32) for name in ("button_mask", "axis_mask")),
        ("name", ctypes.c_char_p),
        *((name, ctypes.c_void_p) for name in ("userdata", "Update", "SetPlayerIndex")),
        ("Rumble", _Rumble),
        *((name, ctypes.c_void_p) for name in ("RumbleTriggers", "SetLED", "SendEffect")),
    )


_JOYSTICK, _GAMECONTROLLER = 0x200, 1
_AXES, _BUTTONS = 6, 15
_TRIGGERS = (4, 5)


def _sdl() -> ctypes.CDLL:
    """The SDL that pygame-ce has loaded into this process."""
    import pygame  # noqa: F401 -- loads it

    lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    library = ctypes.CDLL(next(line.split()[-1] for line in lines if "libSDL2-" in line))
    library.SDL_JoystickOpen.restype = ctypes.c_void_p
    library.SDL_GetError.restype = ctypes.c_char_p
    return library


class VirtualPad:
    """A gamepad that is plugged in for the length of the block, or as long as it is not pulled out.

    Attributes:
        rumbles: strength of each rumble that it was told, 0 to 1; one of a pad `without_motors` is told none.
            One of `unknown_type` has no mapping.
    """

    def __init__(self, without_motors: bool = False, unknown_type: bool = False) -> None:
        self._sdl = _sdl()
        self.rumbles: list[float] = []
        self._description = _Description(
            version=1,
            type=0 if unknown_type else _GAMECONTROLLER,
            naxes=_AXES,
            nbuttons=_BUTTONS,
            name=b"Virtual Controller",
        )
        if not without_motors:
            self._description.Rumble = _Rumble(self._rumble)
        self._pad: ctypes.c_void_p | None = None
        self._index = -1

    def _rumble(self, _: object, low: int, high: int) -> int:
        self.rumbles.append(max(low, high) / 65535)
        return 0

    def plug_in(self) -> None:
        self._index = self._sdl.SDL_JoystickAttachVirtualEx(ctypes.byref(self._description))
        assert self._index >= 0, self._sdl.SDL_GetError()
        self._pad = ctypes.c_void_p(self._sdl.SDL_JoystickOpen(self._index))
        for trigger in _TRIGGERS:
            self.pull(trigger, 0.0)

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
