"""RSI contexts: which object of the KRC is linked to which, and with what parameters.

RSI 3 loads a `.rsi.xml`, whose inputs and outputs count from 1; RSI 4 and later a `.rsix`, where they count from 0.
Here they count from 1. Source: contexts that RSI Visual wrote (RSI 3.1, 4.1 and 5.0).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

from deltaq_protocol.rsi.errors import EthernetConfigError

# input 1 of the object that corrects the external axes, E1, by the way the context counts
_FIRST_EXTERNAL_INPUT = {"RSIObjects": 7, "RsiContext": 1}


@dataclass(frozen=True)
class RsiObject:
    """One object of a context.

    Attributes:
        kind: its type in capitals, e.g. `AXISCORR`.
        name: its own name, e.g. `AXISCORR1`.
        inputs: per input the object and the output that it is linked to, both counted from 1.
        parameters: by name, as written.
    """

    kind: str
    name: str
    inputs: Mapping[int, tuple[str, int]]
    parameters: Mapping[str, str]


@dataclass(frozen=True)
class RsiContext:
    """A context.

    Attributes:
        source: name of its file, for messages.
        objects: in the order of the file.
        first_external_input: the input of AXISCORREXT that corrects E1.
    """

    source: str
    objects: tuple[RsiObject, ...]
    first_external_input: int

    def of_kind(self, kind: str) -> tuple[RsiObject, ...]:
        """All objects of a type."""
        return tuple(thing for thing in self.objects if thing.kind == kind)

    def ethernet(self, config_file: str) -> RsiObject | None:
        """The ETHERNET object that loads this `*_ethernet.xml`; its name ignores case, as on a KRC."""
        loaded = (
            thing
            for thing in self.of_kind("ETHERNET")
            if thing.parameters.get("ConfigFile", "").lower() == config_file.lower()
        )
        return next(loaded, None)


def parse_context(text: str, source: str) -> RsiContext:
    """Read the text of a `.rsi.xml` or a `.rsix`; `source` is its name in messages.

    Raises:
        EthernetConfigError: if it is none.
    """
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise EthernetConfigError(f"{source}: is no XML document: {error}") from error
    kind = _local(root.tag)
    if kind not in _FIRST_EXTERNAL_INPUT:
        allowed = " or ".join(f"<{name}>" for name in _FIRST_EXTERNAL_INPUT)
        raise EthernetConfigError(f"{source}: the outermost element is <{kind}>, must be {allowed}")
    offset = 1 if kind == "RsiContext" else 0
    objects = tuple(
        _object(node, source, offset) for node in root.iter() if _local(node.tag).upper() == "RSIOBJECT"
    )
    return RsiContext(source, objects, _FIRST_EXTERNAL_INPUT[kind])


def _object(node: ET.Element, source: str, offset: int) -> RsiObject:
    own = _attributes(node)
    inputs: dict[int, tuple[str, int]] = {}
    parameters: dict[str, str] = {}
    for below in node.iter():
        attributes = _attributes(below)
        try:
            if _local(below.tag) == "Input":
                link = attributes["outobjid"], int(attributes["outidx"]) + offset
                inputs[int(attributes["inidx"]) + offset] = link
            elif _local(below.tag) == "Parameter":
                parameters[attributes["name"]] = attributes["paramvalue"]
        except (KeyError, ValueError) as error:
            raise EthernetConfigError(
                f"{source}: {own.get('objid', 'an object')}: a link needs InIdx, OutObjID and OutIdx, a parameter Name "
                f"and ParamValue: {error}"
            ) from error
    return RsiObject(own.get("objtype", "").upper(), own.get("objid", ""), inputs, parameters)


def _attributes(node: ET.Element) -> dict[str, str]:
    # RSI 3 writes ObjID, RSI 4 ObjId
    return {name.lower(): value for name, value in node.attrib.items()}


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]
