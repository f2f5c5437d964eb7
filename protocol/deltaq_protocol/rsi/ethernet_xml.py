"""The `*_ethernet.xml` of a KUKA controller: the layout of telegrams in both directions.

The controller and this project load the very same file, so the two cannot disagree. Source: the RSI manuals'
description of the ETHERNET object (elements CONFIG, SEND and RECEIVE; attributes TAG, TYPE, INDX, HOLDON).
"""

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from deltaq_protocol.rsi.axes import ARM_AXES, EXTERNAL_AXES, POSE_AXES, EthernetConfigError
from deltaq_protocol.xml_text import xml_text

MAX_CHANNEL = 64

_TECH = {
    f"Tech.{kind}{i}": tuple(f"{kind}{i}{k}" for k in range(1, 11)) for kind in "CT" for i in range(1, 7)
}

SEND_INTERNAL: dict[str, tuple[str, ...]] = {
    "RIst": POSE_AXES,
    "RSol": POSE_AXES,
    "AIPos": ARM_AXES,
    "ASPos": ARM_AXES,
    "EIPos": EXTERNAL_AXES,
    "ESPos": EXTERNAL_AXES,
    "MACur": ARM_AXES,
    "MECur": EXTERNAL_AXES,
    "Delay": ("D",),
} | _TECH
"""Elements that the controller itself can send, with the attributes of each."""

RECEIVE_INTERNAL: dict[str, tuple[str, ...]] = {"EStr": ()} | _TECH
"""Elements that the controller itself understands; `EStr` is text for the pendant."""

_TAG = re.compile(r"(DEF_)?([A-Za-z0-9_][A-Za-z0-9_-]*)(?:\.([A-Za-z0-9_][A-Za-z0-9_-]*))?")
"""A name may begin with a digit, as in `Out.01`: the telegram is then no XML document, and is still sent."""


class ElementType(StrEnum):
    """Types of a signal."""

    BOOL = "BOOL"
    LONG = "LONG"
    DOUBLE = "DOUBLE"
    STRING = "STRING"


@dataclass(frozen=True)
class Element:
    """One ELEMENT of SEND or RECEIVE.

    Attributes:
        tag: as written, e.g. `DEF_AIPos` or `AK.A1`.
        channel: 1 to 64, or None for elements that the controller fills itself (INDX INTERNAL).
        hold_on: keep the last value when a telegram is late (HOLDON 1), or take 0 (HOLDON 0).
    """

    tag: str
    type: ElementType
    channel: int | None
    hold_on: bool = True

    @property
    def internal(self) -> str | None:
        """Name of an element that the controller handles itself, without `DEF_`."""
        return self.tag.removeprefix("DEF_") if self.channel is None else None

    @property
    def group(self) -> str:
        """The XML element in the telegram."""
        return self.tag.removeprefix("DEF_").partition(".")[0]

    @property
    def attribute(self) -> str | None:
        """The attribute of `group` that carries the value; None: it is the text of the element."""
        return self.tag.partition(".")[2] or None


@dataclass(frozen=True)
class EthernetConfig:
    """A `*_ethernet.xml`.

    Attributes:
        source: its origin, for messages.
        ip_number: the PC's address, to which the controller sends.
        port: the PC's UDP port.
        sentype: the `Type` that a reply must carry.
        only_send: the controller expects no replies.
        send: elements that the controller sends, in order.
        receive: elements that the controller expects, in order.
    """

    source: str
    ip_number: str
    port: int
    sentype: str
    only_send: bool
    send: tuple[Element, ...]
    receive: tuple[Element, ...]


def load_ethernet_xml(path: Path | str) -> EthernetConfig:
    """Read a `*_ethernet.xml`.

    Raises:
        EthernetConfigError: if the file cannot be read or a value in it is not allowed.
    """
    path = Path(path)
    try:
        text = xml_text(path.read_bytes())
    except (OSError, ValueError) as error:
        raise EthernetConfigError(f"{path}: cannot be read: {error}") from error
    return parse_ethernet_xml(text, path.name)


def parse_ethernet_xml(text: str, source: str = "ethernet.xml") -> EthernetConfig:
    """Read the text of a `*_ethernet.xml`; `source` is its name in messages.

    Raises:
        EthernetConfigError: if a value is not allowed.
    """
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise EthernetConfigError(f"{source}: is no XML document: {error}") from error
    if root.tag != "ROOT":
        raise EthernetConfigError(f"{source}: the outermost element is <{root.tag}>, must be <ROOT>")
    port = _config(root, source, "PORT", r"[0-9]{1,5}", "1 to 65535")
    if not 1 <= int(port) <= 65535:
        raise EthernetConfigError(f"{source}: CONFIG/PORT is {port}, allowed is 1 to 65535")
    if (root.findtext("CONFIG/PROTOCOL") or "UDP").strip().upper() != "UDP":
        raise EthernetConfigError(
            f"{source}: CONFIG/PROTOCOL is {root.findtext('CONFIG/PROTOCOL')!r}, allowed is UDP: over another protocol "
            "no telegram of the KRC reaches the Robot Server"
        )
    only_send = _config(root, source, "ONLYSEND", r"(?i:TRUE|FALSE)", "TRUE or FALSE")
    return EthernetConfig(
        source=source,
        ip_number=_config(root, source, "IP_NUMBER", r"[A-Za-z0-9_.:-]{1,253}", "the PC's address"),
        port=int(port),
        sentype=_config(root, source, "SENTYPE", r"[A-Za-z0-9_.-]{1,64}", "up to 64 letters, digits, _ . -"),
        only_send=only_send.upper() == "TRUE",
        send=_elements(root, source, "SEND", SEND_INTERNAL),
        receive=_elements(root, source, "RECEIVE", RECEIVE_INTERNAL),
    )


def _config(root: ET.Element, source: str, name: str, pattern: str, allowed: str) -> str:
    value = (root.findtext(f"CONFIG/{name}") or "").strip()
    if re.fullmatch(pattern, value) is None:
        raise EthernetConfigError(f"{source}: CONFIG/{name} is {value!r}, allowed is {allowed}")
    return value


def _elements(
    root: ET.Element, source: str, direction: str, internal: dict[str, tuple[str, ...]]
) -> tuple[Element, ...]:
    elements: list[Element] = []
    for number, node in enumerate(root.findall(f"{direction}/ELEMENTS/ELEMENT"), start=1):
        where = f"{source}: {direction} element {number} ({node.get('TAG', 'without TAG')})"
        element = _element(node, where, direction, internal)
        for other in elements:
            if other.tag == element.tag:
                raise EthernetConfigError(f"{where}: TAG comes twice, allowed is once")
            if element.channel is not None and other.channel == element.channel:
                raise EthernetConfigError(
                    f"{where}: INDX {element.channel} is used by {other.tag}, "
                    f"allowed is a free one of 1 to {MAX_CHANNEL}"
                )
            if other.group == element.group and (other.attribute is None) != (element.attribute is None):
                raise EthernetConfigError(
                    f"{where}: {element.group} is both an element with text and one with attributes "
                    f"({other.tag}); allowed is one of the two"
                )
        elements.append(element)
    return tuple(elements)


def _element(node: ET.Element, where: str, direction: str, internal: dict[str, tuple[str, ...]]) -> Element:
    tag = node.get("TAG", "")
    if (match := _TAG.fullmatch(tag)) is None or match[2] == "IPOC":
        raise EthernetConfigError(
            f"{where}: TAG is {tag!r}, allowed is NAME, NAME.ATTRIBUTE or DEF_NAME, where a name has "
            "letters, digits, _ and -; IPOC is always there and never listed"
        )
    if (kind := node.get("TYPE", "")) not in ElementType.__members__:
        raise EthernetConfigError(f"{where}: TYPE is {kind!r}, allowed is {', '.join(ElementType)}")
    index = node.get("INDX", "")
    if match[1]:
        if tag.removeprefix("DEF_") not in internal:
            allowed = ", ".join("DEF_" + name for name in internal)
            raise EthernetConfigError(f"{where}: not known in {direction}, allowed is {allowed}")
        if index != "INTERNAL":
            raise EthernetConfigError(f"{where}: INDX is {index!r}, a DEF_ element must have INTERNAL")
        channel = None
    else:
        if re.fullmatch(r"[0-9]{1,2}", index) is None or not 1 <= int(index) <= MAX_CHANNEL:
            raise EthernetConfigError(f"{where}: INDX is {index!r}, allowed is 1 to {MAX_CHANNEL}")
        channel = int(index)
    # text for the pendant is shown when it comes: it has no HOLDON in the maker's files
    hold_on = node.get("HOLDON", "0" if direction == "SEND" or channel is None else "")
    if hold_on not in ("0", "1"):
        raise EthernetConfigError(
            f"{where}: HOLDON is {hold_on!r}, allowed is 1 (keep the last value when late) or 0 (take 0)"
        )
    return Element(tag, ElementType(kind), channel, hold_on == "1")
