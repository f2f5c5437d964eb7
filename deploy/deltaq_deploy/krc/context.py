"""Contexts of RSI 3 as its two files: `.rsi.xml`, which the controller runs, and `.rsi`, which RSI Visual edits.

RSI 4 and later have one `.rsix`, which RSI Visual fills with its own catalogue of objects and nobody is known to have
written by hand: for those there is a list to build it from.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from deltaq_deploy.krc.header import header, xml_comment
from deltaq_deploy.krc.objects import Thing, objects_of
from deltaq_deploy.krc.plan import KrcPlan

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
