"""The layout that controllers write telegrams in, as a pattern for programs that read them without a parser.

A telegram that fits the pattern is read by `SensorCodec.decode` too, with the same numbers; the converse need not hold.
"""

from __future__ import annotations

from collections.abc import Container

from deltaq_protocol.rsi.ethernet_xml import ElementType, EthernetConfig
from deltaq_protocol.rsi.layout import Field, document, send_fields

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
