"""Checks that a KRC's context and KRL program treat corrections as the Robot Server assumes.

The `*_ethernet.xml` says what is on the wire; the context defines which axis a correction moves, and the program
whether it is an offset from the start (absolute) or an increment in every cycle (relative), and how long a cycle is.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from deltaq_protocol.rsi.axes import EthernetConfigError
from deltaq_protocol.rsi.ethernet_xml import EthernetConfig
from deltaq_protocol.rsi.judge import Finding, Station
from deltaq_protocol.rsi.layout import correction_fields

END_OF_MOTION = "4"
"""Mode of the object STOP that ends RSI_MOVECORR."""

RELATIVE_LATE = (
    "corrections are relative: a lost reply would repeat or lose an increment, and the offsets that the Robot Server "
    "sends would run away"
)

_CYCLES_MS = {"#IPO_FAST": 4, "#IPO": 12, "": 4}
"""Cycle by the second argument of RSI_ON; without one it is 4 ms on RSI 3 and later."""


def judge_context(context: RsiContext, config: EthernetConfig, station: Station) -> tuple[Finding, ...]:
    """Check a context against the `*_ethernet.xml` that it loads and against the cell.

    Args:
        context: the context that the KRC has loaded.
        config: the file that its ETHERNET object names.
        station: the cell's description.

    Returns:
        Findings; empty if there are none.
    """
    if (ethernet := context.ethernet(config.source)) is None:
        return ()
    return (*_precision(context, ethernet), *_links(context, ethernet, config, station))


def _precision(context: RsiContext, ethernet: RsiObject) -> Iterator[Finding]:
    written = ethernet.parameters.get("Precision")
    if written is None or written.strip() == "1":
        found = "is not set, so positions come" if written is None else "is 1: positions come"
        yield Finding(
            "warning",
            f"{ethernet.name}/Precision",
            f"{found} with one decimal, a tenth of a degree; write 4",
            written,
            4,
            source=context.source,
        )


def _links(
    context: RsiContext, ethernet: RsiObject, config: EthernetConfig, station: Station
) -> Iterator[Finding]:
    try:
        fields = correction_fields(config, station.axes)
    except EthernetConfigError:
        return  # reported for the file itself
    for axis in station.axes.axes:
        kind = "AXISCORR" if axis[0] == "A" else "AXISCORREXT"
        first = 1 if axis[0] == "A" else context.first_external_input
        number = first + int(axis[1]) - 1
        links = [thing.inputs[number] for thing in context.of_kind(kind) if number in thing.inputs]
        channel = fields[axis].element.channel
        if links != [(ethernet.name, channel)]:
            linked = " and ".join(f"output {output} of {name}" for name, output in links) or "nothing"
            yield Finding(
                "error",
                f"{kind}/Corr{axis}",
                f"is linked to {linked}, but {fields[axis].element.tag} is output {channel} of {ethernet.name}: a "
                "correction would move another axis, or none; link it there",
                linked,
                channel,
                source=context.source,
            )
    if (stop := next((e for e in config.receive if e.tag == station.stop), None)) is not None:
        wired = [
            thing
            for thing in context.of_kind("STOP")
            if (ethernet.name, stop.channel) in thing.inputs.values()
            and thing.parameters.get("Mode") == END_OF_MOTION
        ]
        if not wired:
            yield Finding(
                "error",
                f"STOP/{stop.tag}",
                f"output {stop.channel} of {ethernet.name} leads to no STOP object with Mode {END_OF_MOTION}: the PC "
                "could not end the motion; link it to one",
                None,
                END_OF_MOTION,
                ("stop",),
                context.source,
            )


def judge_program(text: str, source: str, station: Station) -> tuple[Finding, ...]:
    """Check how a KRL program starts RSI.

    Args:
        text: the program.
        source: its name in messages.
        station: the cell's description.

    Returns:
        An error where corrections are relative or the cycle is not the cell's, a warning where the program does not
        say; empty for a program that does not start RSI.
    """
    code = re.sub(r";[^\n]*", "", text)
    return (*_rsi_on(code, source), *_cycle(code, source, station), *_axis_correction(code, source))


def _rsi_on(code: str, source: str) -> Iterator[Finding]:
    for call in re.finditer(r"(?i)\bRSI_ON\s*\(([^)]*)\)", code):
        arguments = call[1].upper()
        if "#RELATIVE" in arguments:
            yield Finding(
                "error",
                "RSI_ON",
                f"{RELATIVE_LATE}; write RSI_ON(#ABSOLUTE, …)",
                call[0],
                "#ABSOLUTE",
                source=source,
            )
        elif "#ABSOLUTE" not in arguments:
            yield Finding(
                "warning",
                "RSI_ON",
                "does not say whether corrections are absolute; write RSI_ON(#ABSOLUTE, …)",
                call[0],
                "#ABSOLUTE",
                source=source,
            )


def _cycle(code: str, source: str, station: Station) -> Iterator[Finding]:
    if station.cycle_s is None or station.axes.krc == "krc2":
        return  # a KR C2 has one cycle, and the cell is checked for it
    cell_ms = round(station.cycle_s * 1000)
    for call in re.finditer(r"(?i)\bRSI_ON\s*\(([^)]*)\)", code):
        option = call[1].upper().partition(",")[2].strip()
        cycle_ms = _CYCLES_MS.get(option)
        if cycle_ms is None:
            yield Finding(
                "warning",
                "RSI_ON",
                f"its cycle is {option}, which cannot be read here; write #IPO_FAST (4 ms) or #IPO (12 ms)",
                call[0],
                cell_ms,
                source=source,
            )
        elif cycle_ms != cell_ms:
            said = option or "without a second argument"
            yield Finding(
                "error",
                "RSI_ON",
                f"{said} is a cycle of {cycle_ms} ms, and cycle_s of the cell is {cell_ms} ms: every increment would "
                f"take {cycle_ms} ms, and the robot would move {cell_ms / cycle_ms:.3g} times as fast as admitted; "
                "write #IPO_FAST (4 ms) or #IPO (12 ms) as the cell says, or change cycle_s",
                call[0],
                cell_ms,
                source=source,
            )


def _axis_correction(code: str, source: str) -> Iterator[Finding]:
    for created in re.finditer(r"(?i)\bST_AXISCORR\s*\(\s*(\w+)", code):
        mode = re.search(rf"(?i)\bST_SETPARAM\s*\(\s*{created[1]}\s*,\s*1\s*,\s*([^)\s]+)\s*\)", code)
        if mode is not None and mode[1] == "0":
            continue
        if mode is not None and mode[1] == "1":
            yield Finding(
                "error",
                "ST_AXISCORR",
                f"{RELATIVE_LATE}; write ST_SETPARAM({created[1]}, 1, 0)",
                1,
                0,
                source=source,
            )
        else:
            yield Finding(
                "warning",
                "ST_AXISCORR",
                f"its mode is not set, or by something that cannot be read here; write ST_SETPARAM({created[1]}, 1, 0) "
                "for absolute corrections",
                None if mode is None else mode[1],
                0,
                source=source,
            )


# RSI contexts: the KRC's objects, their links and their parameters. RSI 3 loads a `.rsi.xml`, whose
# inputs and outputs count from 1; RSI 4 and later a `.rsix`, where they count from 0. Here they count from 1. Source:
# contexts that RSI Visual wrote (RSI 3.1, 4.1 and 5.0).

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
