"""The reports of a SpaceMouse that is plugged in, through hidapi. The device comes and goes while one looks."""

from __future__ import annotations

from typing import Any

from deltaq_controllers.interface import ControllerError

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
    """Whether what hidapi found is a 6-axis controller, and not another interface of it."""
    maker, product = found["vendor_id"], found["product_id"]
    is_made = maker == _MAKER or (maker == _MAKER_BEFORE and product in _PRODUCTS_BEFORE)
    return is_made and (found.get("usage_page", 0), found.get("usage", 0)) in (_CONTROLLER, _UNKNOWN)


class SpaceMouseDevice:
    """The first one that is plugged in.

    Attributes:
        name: of the device; empty while there is none.
    """

    def __init__(self) -> None:
        self.name = ""
        self._hid: Any = None
        self._device: Any = None
        self._search_s = 0.0

    def open(self) -> None:
        """Find a device.

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
        """The reports that have come since the last call at a time [s]; None while no device is plugged in."""
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
        """Give the device back."""
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
