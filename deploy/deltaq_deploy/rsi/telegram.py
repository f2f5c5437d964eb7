"""What a datagram of a KRC holds, read without knowing its `*_ethernet.xml`."""

from __future__ import annotations

import re
from dataclasses import dataclass

MAX_BYTES = 4096
"""More is no telegram."""

_HEAD = re.compile(rb'\s*<Rob\s+(?i:Type)="KUKA"\s*>')
_IPOC = re.compile(rb"<IPOC>\s*([0-9]{1,20})\s*</IPOC>")
_ELEMENT = re.compile(rb'<([A-Za-z0-9_][\w-]*)((?:\s+[\w.-]+="[^"<>]*")*)\s*(?:/>|>)')
_ATTRIBUTE = re.compile(rb'([\w.-]+)="([^"<>]*)"')
_DECIMALS = re.compile(rb"[-+]?[0-9]+\.([0-9]+)")


@dataclass(frozen=True)
class Seen:
    """What is in a datagram.

    Attributes:
        ipoc: its time stamp.
        elements: `AIPos.A1`, or the name alone of an element with text; without IPOC, in their order.
        delay: late replies as the KRC counts them; None if it does not say.
        decimals: most decimals of a number in it; None if no number has any.
    """

    ipoc: int
    elements: tuple[str, ...]
    delay: int | None
    decimals: int | None


def look_at(datagram: bytes) -> Seen | None:
    """Read a datagram; None if it is no telegram of a KRC."""
    if (
        len(datagram) > MAX_BYTES
        or _HEAD.match(datagram) is None
        or (stamp := _IPOC.search(datagram)) is None
    ):
        return None
    elements: list[str] = []
    delay = decimals = None
    for name, attributes in _ELEMENT.findall(datagram):
        if name in (b"Rob", b"IPOC"):
            continue
        pairs = _ATTRIBUTE.findall(attributes)
        elements += [f"{name.decode()}.{key.decode()}" for key, _ in pairs] or [name.decode()]
        for key, value in pairs:
            if name == b"Delay" and key == b"D" and value.strip().isdigit():
                delay = int(value)
            elif (number := _DECIMALS.fullmatch(value.strip())) is not None:
                decimals = max(decimals or 0, len(number[1]))
    return Seen(int(stamp[1]), tuple(elements), delay, decimals)
