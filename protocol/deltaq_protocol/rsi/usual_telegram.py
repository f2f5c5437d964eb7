"""Telegrams in the layout that controllers write, as far as it takes to tell what the next one will be.

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

NO_JOINT = -1
"""In place of a joint: a value that is no joint's position."""


class UsualTelegrams:
    """Reads telegrams of one robot.

    Args:
        config: the controller's `*_ethernet.xml`; it reports all joints.
        axes: the robot's joints.

    Attributes:
        pattern: regular expression of a whole telegram.
        order: (k,) whose position each of its values is that may vary while a session goes well: the joint's index, or
            `NO_JOINT`. What the controller counts as late, and the programmed position, stay as they are.
        programmed: beginnings of the elements that hold the programmed position; none if it is not sent.
    """

    def __init__(self, config: EthernetConfig, axes: AxisMap) -> None:
        order: list[int] = []
        programmed: dict[str, None] = {}

        def value(field: Field) -> str:
            internal, axis = field.element.internal, field.attribute or ""
            if field.element.type is ElementType.STRING:
                return '[^"<]*+'
            if internal in ("ASPos", "ESPos"):
                programmed[field.group] = None
            if internal in ("ASPos", "ESPos", "Delay"):
                return _NUMBER
            is_joint = internal in ("AIPos", "EIPos") and axis in axes.axes
            order.append(axes.axes.index(axis) if is_joint else NO_JOINT)
            return f"({_NUMBER})"

        pattern = document("Rob", '(?i:Type)="KUKA"', send_fields(config), value, _GAP)
        pattern = f"{_GAP}{pattern.replace('%IPOC%', '[0-9]{1,10}+')}{_GAP}"
        self.pattern = pattern
        self._match = re.compile(pattern.encode()).fullmatch
        self.programmed = tuple(f"<{group} " for group in programmed)
        self.order = tuple(order)

    def places(self, datagram: bytes) -> list[tuple[int, int]] | None:
        """Where the values of `order` stand in such a telegram, first and behind the last byte; None if it is none."""
        match = self._match(datagram) if len(datagram) <= MAX_TELEGRAM_BYTES else None
        return None if match is None else [match.span(1 + value) for value in range(len(self.order))]

    @staticmethod
    def ipoc(datagram: bytes) -> int:
        """Its IPOC."""
        return int(datagram[datagram.rindex(_IPOC) + len(_IPOC) : datagram.rindex(_IPOC_ENDS)])

    @staticmethod
    def with_ipoc(datagram: bytes, ipoc: int) -> bytes:
        """The telegram with another IPOC."""
        head, tail = datagram[: datagram.rindex(_IPOC)], datagram[datagram.rindex(_IPOC_ENDS) :]
        return b"%b%b%d%b" % (head, _IPOC, ipoc, tail)
