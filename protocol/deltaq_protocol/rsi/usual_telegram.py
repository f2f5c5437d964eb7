"""Telegrams read without an array, as far as it takes to see that they are what was expected.

What is read here is read by `SensorCodec.decode` too, with the same numbers; the converse need not hold.
"""

from __future__ import annotations

import re

from deltaq_protocol.rsi.axes import AxisMap
from deltaq_protocol.rsi.ethernet_xml import ElementType, EthernetConfig
from deltaq_protocol.rsi.layout import Field, document, send_fields
from deltaq_protocol.rsi.sensor_codec import MAX_TELEGRAM_BYTES

# as `layout.NUMBER`, but never tried in two ways: what may follow a digit is no digit
_NUMBER = r"[-+]?[0-9]{1,16}+(?:\.[0-9]{0,16}+)?+(?:[eE][-+]?[0-9]{1,2}+)?+"
_GAP = r"\s*+"
_IPOC, _IPOC_ENDS = b"<IPOC>", b"</IPOC>"


class UsualTelegrams:
    """Reads telegrams of one robot.

    Args:
        config: the controller's `*_ethernet.xml`; it reports all joints.
        axes: the robot's joints.

    Attributes:
        order: (n,) which joint each of those is that `joints` returns.
        pattern: regular expression of a whole telegram.
        programmed: beginnings of the elements that hold the programmed position; none if it is not sent.
    """

    def __init__(self, config: EthernetConfig, axes: AxisMap) -> None:
        order: list[int] = []
        steady: dict[str, None] = {}

        def value(field: Field) -> str:
            internal, axis = field.element.internal, field.attribute or ""
            if internal in ("ASPos", "ESPos", "Delay"):
                steady[field.group] = None
            if internal in ("AIPos", "EIPos") and axis in axes.axes:
                order.append(axes.axes.index(axis))
                return f"({_NUMBER})"
            return '[^"<]*+' if field.element.type is ElementType.STRING else _NUMBER

        pattern = document("Rob", '(?i:Type)="KUKA"', send_fields(config), value, _GAP)
        pattern = f"{_GAP}{pattern.replace('%IPOC%', '[0-9]{1,10}+')}{_GAP}"
        self.pattern = pattern
        self._match = re.compile(pattern.encode()).fullmatch
        self._steady = tuple(f"<{group} ".encode() for group in steady)
        self.programmed = tuple(f"<{group} " for group in steady if group != "Delay")
        self.order = tuple(order)

    def joints(self, datagram: bytes) -> tuple[bytes, ...] | None:
        """The measured joints (n,), in the order of the telegram and as they were written; None if it is none of these.

        They are decimal numbers in the controller's units.
        """
        match = self._match(datagram) if len(datagram) <= MAX_TELEGRAM_BYTES else None
        return None if match is None else match.groups()

    def steady(self, datagram: bytes) -> tuple[bytes, ...]:
        """The elements of such a telegram that stay as they are while a session goes well: `ASPos`, `ESPos`, `Delay`.

        There is no other place in any such telegram where one of them could stand.
        """
        starts = [datagram.index(name) for name in self._steady]
        return tuple(datagram[start : datagram.index(b">", start) + 1] for start in starts)

    @staticmethod
    def ipoc(datagram: bytes) -> int:
        """Its IPOC."""
        return int(datagram[datagram.rindex(_IPOC) + len(_IPOC) : datagram.rindex(_IPOC_ENDS)])

    @staticmethod
    def end(datagram: bytes, ipoc: int) -> bytes:
        """Its end, from its IPOC on, with another one."""
        return b"%b%d%b" % (_IPOC, ipoc, datagram[datagram.rindex(_IPOC_ENDS) :])
