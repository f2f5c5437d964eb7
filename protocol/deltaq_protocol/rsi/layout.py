"""The order of a telegram's fields, as both ends compile it from the configuration."""

from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass

from deltaq_protocol.rsi.axes import ARM_AXES, EXTERNAL_AXES, AxisMap, EthernetConfigError
from deltaq_protocol.rsi.ethernet_xml import (
    RECEIVE_INTERNAL,
    SEND_INTERNAL,
    Element,
    ElementType,
    EthernetConfig,
)

MAX_IPOC = 2**32 - 1

DECIMALS = 6
"""Decimals of a correction on the wire."""

NUMBER = r"[-+]?[0-9]{1,16}(?:\.[0-9]{0,16})?(?:[eE][-+]?[0-9]{1,2})?"
"""A decimal number as controllers write it; too short to overflow."""


@dataclass(frozen=True)
class Field:
    """One value of a telegram: `attribute` of the XML element `group`, or its text where that is None."""

    group: str
    attribute: str | None
    element: Element


def send_fields(config: EthernetConfig) -> tuple[Field, ...]:
    """The values of a telegram from the controller, in order, without IPOC."""
    return _fields(config.send, SEND_INTERNAL)


def receive_fields(config: EthernetConfig) -> tuple[Field, ...]:
    """The values of a reply, in order, without IPOC; a channel tagged `FREE` is not on the wire."""
    return _fields((element for element in config.receive if element.tag != "FREE"), RECEIVE_INTERNAL)


def _fields(elements: Iterable[Element], internal: dict[str, tuple[str, ...]]) -> tuple[Field, ...]:
    groups: dict[str, list[Field]] = {}
    for element in elements:
        group = groups.setdefault(element.group, [])
        if element.internal is not None:
            names: tuple[str | None, ...] = internal[element.internal] or (None,)
        else:
            names = (element.attribute,)
        group.extend(Field(element.group, name, element) for name in names)
    return tuple(field for group in groups.values() for field in group)


def document(
    name: str, attribute: str, fields: Iterable[Field], value: Callable[[Field], str], gap: str = ""
) -> str:
    """A telegram in the compact form: `<name attribute>` … `</name>`.

    Each place holds `value(field)`, the last one the text `%IPOC%`. `gap` goes wherever XML allows white
    space: the empty string for a telegram, a pattern to read one.
    """
    groups: dict[str, list[Field]] = {}
    for field in fields:
        groups.setdefault(field.group, []).append(field)
    parts = []
    for group, members in groups.items():
        if members[0].attribute is None:
            parts.append(f"<{group}>{value(members[0])}</{group}>")
        else:
            attributes = "".join(f' {member.attribute}="{value(member)}"' for member in members)
            parts.append(f"<{group}{attributes}{gap}/>")
    body = "".join(part + gap for part in parts)
    return f"<{name} {attribute}>{gap}{body}<IPOC>%IPOC%</IPOC>{gap}</{name}>"


def correction_fields(config: EthernetConfig, axes: AxisMap) -> dict[str, Field]:
    """The field of a reply that corrects each axis, by the axis's name.

    The arm's correction is the one group of DOUBLE signals whose attributes are A1 … A6, whatever its tag
    (`AK`, `AKorr`, …), the external axes' the one with E1 … E6.

    Raises:
        EthernetConfigError: if an axis has no correction, or there is more than one group it could be.
    """
    found: dict[str, Field] = {}
    for names in (ARM_AXES, EXTERNAL_AXES):
        candidates = [
            field
            for field in receive_fields(config)
            if field.element.type is ElementType.DOUBLE and field.attribute in names
        ]
        groups = sorted({field.group for field in candidates})
        if len(groups) > 1:
            raise EthernetConfigError(
                f"{config.source}: RECEIVE has {' and '.join(groups)}, each of which could be the correction "
                f"of {names[0]} … {names[-1]}; allowed is one group with such attributes"
            )
        found |= {str(field.attribute): field for field in candidates}
    if missing := [axis for axis in axes.axes if axis not in found]:
        example = f"{'AK' if missing[0][0] == 'A' else 'EK'}.{missing[0]}"
        raise EthernetConfigError(
            f"{config.source}: RECEIVE has no correction of {', '.join(missing)}; "
            f"add one ELEMENT with a TAG like {example} and TYPE DOUBLE for each"
        )
    return found


def digital_fields(
    config: EthernetConfig, direction: str, fields: Iterable[Field], tags: Mapping[str, str]
) -> dict[str, Field]:
    """The field of each digital signal, by the signal's name.

    Args:
        config: the fields are of.
        direction: SEND or RECEIVE, for messages.
        fields: of that direction.
        tags: per name of a signal its TAG.

    Raises:
        EthernetConfigError: if there is no BOOL with that TAG, or two signals share one.
    """
    signals = {field.element.tag: field for field in fields if field.element.type is ElementType.BOOL}
    taken: dict[str, str] = {}
    for name, tag in tags.items():
        if tag not in signals:
            raise EthernetConfigError(
                f"{config.source}: {direction} has no BOOL signal {tag}, which the cell names for {name}; it has "
                f"{', '.join(signals) or 'none'}; add an ELEMENT with that TAG and TYPE BOOL"
            )
        if tag in taken:
            raise EthernetConfigError(
                f"{config.source}: {tag} of {direction} is named for {taken[tag]} and for {name}; "
                "give each a signal of its own"
            )
        taken[tag] = name
    return {name: signals[tag] for name, tag in tags.items()}


# The layout that controllers write telegrams in, as a pattern for programs that read them without a parser. A telegram
# that fits the pattern is read by `SensorCodec.decode` too, with the same numbers; the converse need not hold.

# as `layout.NUMBER`, but never tried in two ways: what may follow a digit is no digit
_NUMBER = r"[-+]?[0-9]{1,16}+(?:\.[0-9]{0,16}+)?+(?:[eE][-+]?[0-9]{1,2}+)?+"
_GAP = r"\s*+"


def usual_telegram(
    config: EthernetConfig, captured: Container[Field] | None = None
) -> tuple[str, tuple[str, ...]]:
    """The pattern of a robot's telegrams, and where they hold the programmed position.

    Args:
        config: the controller's `*_ethernet.xml`.
        captured: fields whose values are captured, and then the IPOC; None: nothing is.

    Returns:
        The regular expression of a whole telegram, and the beginnings of the elements that hold the programmed
        position; none if it is not sent.
    """
    programmed: dict[str, None] = {}

    def value(field: Field) -> str:
        if field.element.type is ElementType.STRING:
            return '[^"<]*+'
        if field.element.internal in ("ASPos", "ESPos"):
            programmed[field.group] = None
        return f"({_NUMBER})" if captured is not None and field in captured else _NUMBER

    pattern = document("Rob", '(?i:Type)="KUKA"', send_fields(config), value, _GAP)
    ipoc = "[0-9]{1,10}+" if captured is None else "([0-9]{1,10}+)"
    pattern = f"{_GAP}{pattern.replace('%IPOC%', ipoc)}{_GAP}"
    return pattern, tuple(f"<{group} " for group in programmed)
