"""Contexts of RSI 3 as its two files: `.rsi.xml`, which the controller runs, and `.rsi`, which RSI Visual edits.

RSI 4 and later have one `.rsix`, which RSI Visual fills with its own catalogue of objects; no hand-written one is
known, so for those there is a list to build it from.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

from deltaq_deploy.krc.plan import (
    PRECISION,
    TIMEOUT_CYCLES,
    Correction,
    KrcPlan,
    Signal,
    header,
    written,
    xml_comment,
)
from deltaq_protocol.rsi.axes import ARM_AXES, EXTERNAL_AXES

# The objects of an RSI context, their links and parameters, from the plan.
#
# Types, numbers, ports and parameter names are those of contexts that RSI Visual wrote for RSI 3 (AXISCORR,
# AXISCORRMON, ETHERNET and STOP have moved a KR 16 there; no report of a trial of AXISCORREXT is known).

ETHERNET = "ETHERNET1"
UNCORRECTED = 6.0
"""The maker's default of a monitor [deg or mm], for axes that are not corrected."""


@dataclass(frozen=True)
class SignalLink:
    """An input of an object and the output that it is linked to, both counted from 1."""

    port: str
    number: int
    source: str
    output: int
    signal: str | None = None


@dataclass(frozen=True)
class Parameter:
    """A parameter of an object.

    Attributes:
        name: name of the parameter.
        number: its number in RSI 3.
        value: as the controller reads it.
        shown: as RSI Visual shows it, where that differs.
        kind: type in RSI Visual.
        runtime: can be changed while RSI runs.
        least: smallest value in RSI Visual.
        most: largest value.
    """

    name: str
    number: int
    value: str
    shown: str | None = None
    kind: str = "System.Double"
    runtime: bool = True
    least: int = -(2**31)
    most: int = 2**31 - 1


@dataclass(frozen=True)
class Thing:
    """One object: its type, the number of the type, links, outputs and parameters."""

    kind: str
    name: str
    type_number: int
    links: tuple[SignalLink, ...] = ()
    outputs: tuple[tuple[str, str | None], ...] = ()
    parameters: tuple[Parameter, ...] = ()


def objects_of(plan: KrcPlan) -> tuple[Thing, ...]:
    """The objects of the context, the ETHERNET object last."""
    inputs = [
        _digital("DIGIN", number, 29, signal, "RSI_DataSize")
        for number, signal in enumerate(_wired(plan.inputs), start=1)
    ]
    outputs = [
        _digital("MAP2DIGOUT", number, 14, signal, "RSI_DataSizeX")
        for number, signal in enumerate(_wired(plan.outputs), start=1)
    ]
    things = [*inputs, _correction("AXISCORR", plan.arm, ARM_AXES, "Stat")]
    if plan.external:
        things.append(_correction("AXISCORREXT", plan.external, EXTERNAL_AXES))
    things += [_monitor(plan), *outputs]
    if plan.stop is not None:
        things.append(
            Thing(
                "STOP",
                "STOP1",
                18,
                (SignalLink("In1", 1, ETHERNET, plan.stop.channel, "Bool"),),
                (),
                (Parameter("Mode", 1, "4", "ExitMoveCorr", "KUKA.RSIVisual.RSI_StopType"),),
            )
        )
    return (*things, _ethernet(plan, inputs))


def _correction(kind: str, corrections: Sequence[Correction], axes: Sequence[str], *stat: str) -> Thing:
    limits = [Parameter(f"LowerLim{one.axis}", one.number, written(one.lower)) for one in corrections]
    limits += [Parameter(f"UpperLim{one.axis}", one.number + 12, written(one.upper)) for one in corrections]
    links = [SignalLink(f"Corr{one.axis}", one.number, ETHERNET, one.channel) for one in corrections]
    outputs = (*((name, "Int") for name in stat), *((axis, None) for axis in axes))
    return Thing(kind, f"{kind}1", 33, tuple(links), outputs, tuple(limits))


def _monitor(plan: KrcPlan) -> Thing:
    axes = (*ARM_AXES, *EXTERNAL_AXES)
    corrected = {one.axis: one.monitored for one in plan.corrections}
    bounds = [
        Parameter(f"Max{axis}", number, written(corrected.get(axis, UNCORRECTED)), least=0)
        for number, axis in enumerate(axes, start=1)
    ]
    return Thing("AXISCORRMON", "AXISCORRMON1", 82, (), tuple((axis, None) for axis in axes), tuple(bounds))


def _wired(signals: Sequence[Signal]) -> list[Signal]:
    return [signal for signal in signals if signal.digital is not None]


def _digital(kind: str, number: int, type_number: int, signal: Signal, size: str) -> Thing:
    """An object of the KRC's own $IN or $OUT."""
    is_input = kind == "DIGIN"
    return Thing(
        kind,
        f"{kind}{number}",
        type_number,
        () if is_input else (SignalLink("In1", 1, ETHERNET, signal.channel, "Int"),),
        (("Out1", "Int"),) if is_input else (),
        (
            Parameter("Index", 1, str(signal.digital), kind="System.Int32", least=1, most=4096),
            Parameter("DataSize", 2, "0", "Bit", f"KUKA.RSIVisual.{size}"),
        ),
    )


def _ethernet(plan: KrcPlan, inputs: list[Thing]) -> Thing:
    links = tuple(
        SignalLink(f"In{signal.channel}", signal.channel, source.name, 1)
        for signal, source in zip(_wired(plan.inputs), inputs, strict=True)
    )
    last = plan.stop or (plan.outputs or plan.corrections)[-1]
    return Thing(
        "ETHERNET",
        ETHERNET,
        64,
        links,
        tuple((f"Out{number}", None) for number in range(1, last.channel + 1)),
        (
            Parameter("ConfigFile", 1, plan.ethernet_xml, kind="System.FileName", runtime=False),
            Parameter("Timeout", 1, str(TIMEOUT_CYCLES), kind="System.Int32", least=0),
            Parameter("Flag", 4, "1", kind="System.Int32", least=-1, most=999),
            Parameter("Precision", 8, str(PRECISION), kind="System.Int32", least=1, most=32),
        ),
    )


_MODEL = "http://schemas.microsoft.com/dsltools/RSIVisual"
_SCHEMA = "/Roboter/Config/System/Common/Schemes/RSIContext.xsd"


def rsi_xml(plan: KrcPlan) -> str:
    """The text of the `.rsi.xml`."""
    root = ET.Element(
        "RSIObjects",
        {
            "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
            "xsi:noNamespaceSchemaLocation": _SCHEMA,
        },
    )
    for thing in objects_of(plan):
        node = ET.SubElement(
            root, "RSIObject", ObjType=thing.kind, ObjTypeID=str(thing.type_number), ObjID=thing.name
        )
        if thing.links:
            inputs = ET.SubElement(node, "Inputs")
            for link in thing.links:
                ET.SubElement(
                    inputs, "Input", InIdx=str(link.number), OutObjID=link.source, OutIdx=str(link.output)
                )
        if thing.parameters:
            parameters = ET.SubElement(node, "Parameters")
            for one in thing.parameters:
                written = {"Name": one.name, "ParamID": str(one.number), "ParamValue": one.value}
                ET.SubElement(
                    parameters, "Parameter", written | ({} if one.runtime else {"IsRuntime": "false"})
                )
    return _document(root, header(plan, "RSI context"))


def rsi_model(plan: KrcPlan) -> str:
    """The text of the `.rsi`."""
    root = ET.Element("rSIModel", {"dslVersion": "1.0.0.0", "name": "", "xmlns": _MODEL})
    objects = ET.SubElement(root, "rSIObjects")
    things = objects_of(plan)
    ports = {thing.name: [name for name, _ in thing.outputs] for thing in things}
    for thing in things:
        _element(objects, thing, ports)
    return _document(root, header(plan, "RSI context, as RSI Visual edits it,"))


def _element(objects: ET.Element, thing: Thing, ports: dict[str, list[str]]) -> None:
    many = "64" if thing.kind == "ETHERNET" else "0"
    attributes = {"name": thing.name, "objType": thing.kind, "objTypeID": str(thing.type_number)}
    if thing.kind == "AXISCORREXT":
        attributes |= {"outputOffset": "8", "inputOffset": "7"}
    node = ET.SubElement(objects, "rSIElement", attributes | {"maxInputs": many, "maxOutputs": many})
    if thing.links:
        inputs = ET.SubElement(node, "rSIInPorts")
        for link in thing.links:
            kind = {"signalType": link.signal} if link.signal else {"mandatory": "false"}
            source = ET.SubElement(ET.SubElement(inputs, "rSIInPort", {"name": link.port} | kind), "source")
            output = ports[link.source][link.output - 1]
            ET.SubElement(source, "rSIOutPortMoniker", name=f"//{link.source}/{output}")
    if thing.outputs:
        outputs = ET.SubElement(node, "rSIOutPorts")
        for name, signal in thing.outputs:
            ET.SubElement(outputs, "rSIOutPort", {"name": name} | ({"signalType": signal} if signal else {}))
    parameters = ET.SubElement(node, "rSIParameters")
    for one in thing.parameters:
        written = {
            "name": one.name,
            "value": one.shown or one.value,
            "paramType": one.kind,
            "minVal": str(one.least),
            "maxVal": str(one.most),
            "isEnum": "false" if one.shown is None else "true",
        }
        if not one.runtime:
            written["isRuntime"] = "false"
        ET.SubElement(parameters, "rSIParameter", written | {"index": str(one.number)})


def _document(root: ET.Element, comment: list[str]) -> str:
    ET.indent(root)
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    return head + xml_comment(comment) + ET.tostring(root, encoding="unicode") + "\n"


def visual_list(plan: KrcPlan) -> str:
    """What to build in RSI Visual, object by object, for RSI 4 and later."""
    lines = [
        *header(plan, "Context"),
        "",
        f"RSI Visual (in WorkVisual) makes {plan.program}.rsix from this list. Object and parameter names are RSI 3's;",
        "later versions write some of them in lower case (AxisCorr, Ethernet) and count inputs from 0 in the file.",
        "Have `deltaq check` read the .rsix afterwards: put it beside the cell's *_ethernet.xml.",
    ]
    for thing in objects_of(plan):
        lines += ["", f"{thing.kind}  ({thing.name})"]
        lines += [f"   {one.name:<12} = {one.shown or one.value}" for one in thing.parameters]
        lines += [f"   input {link.port:<6} <- output {link.output} of {link.source}" for link in thing.links]
    return "\n".join(lines) + "\n"
