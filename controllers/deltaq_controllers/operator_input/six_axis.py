"""A 6-axis hand controller (SpaceMouse), from the bytes of its HID reports. Pure: times are handed in.

Report 1 has the translation and report 2 the rotation, three little-endian 16-bit numbers each; on newer devices report
1 has both. Report 3 has a bit for each button. The device's own axes point right, to the operator, and down, and turns
are right-handed about them. The cap reports again and again while it is deflected, and once when it is let go.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from deltaq_controllers.modes.motion import HAND_AXES
from deltaq_controllers.operator_input.dead_zone import beyond_dead_zone

FULL = 350
"""Greatest deflection that a device reports."""
MOST = 3 * FULL
"""A number beyond it is none of a deflection."""
SETTLE_S = 0.3
"""A cap that is deflected as the device is found reports so within this."""
STALE_S = 0.3
"""A cap that is deflected and has not reported for so long is not believed: a radio link may be gone."""

_TRANSLATION, _ROTATION, _BUTTONS = 1, 2, 3
_THREE, _SIX = struct.Struct("<3h"), struct.Struct("<6h")
_MOST_BUTTON_BYTES = 6
_PLACES = (1, 0, 2, 4, 3, 5)
"""Which number of the device is about each axis of a hand; all point the other way."""


@dataclass(frozen=True)
class SixAxisState:
    """How a controller stands.

    Attributes:
        rates: deflection along and about each axis of a hand, from -1 to 1; x is ahead, y left, z up.
        held: buttons that are held, counted from 0.
        pressed: buttons that went down since the last look, in their order.
    """

    rates: dict[str, float]
    held: frozenset[int] = frozenset()
    pressed: tuple[int, ...] = ()


class SixAxis:
    """Where a cap stands, report by report. A deflection counts once every axis was at rest since the device was found.

    Attributes:
        ignored: reports that were malformed, or of a kind that says nothing of cap and buttons.
    """

    def __init__(self) -> None:
        self.ignored = 0
        self.forget()

    def forget(self) -> None:
        """The device is gone: its last values are no longer valid."""
        self._raw: list[int | None] = [0] * len(HAND_AXES)
        self._held: frozenset[int] = frozenset()
        self._let_go: set[int] = set()
        self._settled_s: float | None = None
        self._told_s = 0.0

    def look(self, reports: Iterable[bytes], time_s: float) -> SixAxisState:
        """How the controller stands after reports that have come until a time [s]."""
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
            self._held = frozenset()  # what is held as the device is found was not meant for the robot
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
