"""Telegrams read without an array, as far as it takes to see that they are what was expected.

What is read here is read by `SensorCodec.decode` too, with the same numbers; the converse need not hold.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from operator import itemgetter

from deltaq_protocol.rsi.axes import AxisMap
from deltaq_protocol.rsi.ethernet_xml import ElementType, EthernetConfig
from deltaq_protocol.rsi.layout import Field, document, send_fields

MAX_USUAL_BYTES = 4096

# as `layout.NUMBER`, but never tried in two ways: what may follow a digit is no digit
_NUMBER = r"[-+]?[0-9]{1,16}+(?:\.[0-9]{0,16}+)?+(?:[eE][-+]?[0-9]{1,2}+)?+"
_GAP = r"\s*+"


Texts = tuple[bytes, ...]


class UsualTelegrams:
    """Reads telegrams of one robot.

    Args:
        config: the controller's `*_ethernet.xml`; it reports all joints.
        axes: the robot's joints.
    """

    def __init__(self, config: EthernetConfig, axes: AxisMap) -> None:
        measured: dict[str, int] = {}
        steady: list[int] = []

        def value(field: Field) -> str:
            internal, axis = field.element.internal, field.attribute or ""
            if internal in ("AIPos", "EIPos") and axis in axes.axes:
                measured[axis] = 1 + len(measured) + len(steady)
            elif internal == "Delay" or (internal in ("ASPos", "ESPos") and axis in axes.axes):
                steady.append(1 + len(measured) + len(steady))
            else:
                return '[^"<]*+' if field.element.type is ElementType.STRING else _NUMBER
            return f"({_NUMBER})"

        pattern = document("Rob", '(?i:Type)="KUKA"', send_fields(config), value, _GAP)
        pattern = f"{_GAP}{pattern.replace('%IPOC%', '([0-9]{1,10}+)')}{_GAP}"
        self._match: Callable[[bytes], re.Match[bytes] | None] = re.compile(pattern.encode()).fullmatch
        self._q = _getter([measured[axis] for axis in axes.axes])
        self._steady = _getter([*steady, 1 + len(measured) + len(steady)])

    def read(self, datagram: bytes) -> tuple[Texts, Texts] | None:
        """What a datagram says, as it was written; None if it is none of these telegrams.

        Returns:
            (n,) measured joints, decimal numbers in the controller's units; and what stays as it is while a session
            goes well, programmed joints and late packets, with the IPOC as the last.
        """
        match = self._match(datagram) if len(datagram) <= MAX_USUAL_BYTES else None
        if match is None:
            return None
        values = match.groups()
        return self._q(values), self._steady(values)


def _getter(places: list[int]) -> Callable[[Texts], Texts]:
    """Takes these groups of a match out of all."""
    if len(places) > 1:
        return itemgetter(*(place - 1 for place in places))
    (place,) = places
    return itemgetter(slice(place - 1, place))
