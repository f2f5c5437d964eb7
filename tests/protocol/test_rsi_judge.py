"""The judge of a KRC's files: what cannot be safe is refused, what makes an outage worse is told."""

from dataclasses import replace
from pathlib import Path

import pytest

import deltaq_deploy
from deltaq_protocol.rsi import AxisMap, EthernetConfig, EthernetConfigError
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml
from deltaq_protocol.rsi.judge import Finding, Station, judge
from deltaq_protocol.rsi.judge_program import judge_context, judge_program, parse_context

GANTRY = (Path(deltaq_deploy.__file__).parent / "krc" / "gr_ethernet.xml").read_text(encoding="utf-8")
AXES = AxisMap(("e1", "e2", "e3", *(f"a{i}" for i in range(1, 7))), ("m",) * 3 + ("rad",) * 6, "krc2")
CELL = Station(
    AXES, "192.168.10.10", 49153, {"closed": "Di.I1", "locked": "Di.I2"}, {"gripper": "Do.O1"}, "Stop"
)


def file(*edits: tuple[str, str]) -> EthernetConfig:
    text = GANTRY
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return parse_ethernet_xml(text, "gr_ethernet.xml")


def without(tag: str) -> tuple[str, str]:
    (line,) = [line for line in GANTRY.splitlines() if f'TAG="{tag}"' in line]
    return line, ""


def correction(axis: str, channel: int, hold_on: int = 1) -> str:
    group = "AK" if axis[0] == "A" else "EK"
    return f'TAG="{group}.{axis}" TYPE="DOUBLE" INDX="{channel}" UNIT="0" HOLDON="{hold_on}"'


def swapped(one: str, other: str) -> list[tuple[str, str]]:
    number = {"A1": 1, "A2": 2, "E1": 7, "E2": 8}
    a, b = number[one], number[other]
    return [
        (correction(one, a), correction(one, 99)),
        (correction(other, b), correction(other, a)),
        (correction(one, 99), correction(one, b)),
    ]


def only(findings: tuple[Finding, ...]) -> Finding:
    (finding,) = findings
    return finding


def test_the_shipped_file_passes_without_findings() -> None:
    assert judge(file(), CELL) == ()


# edits of the file, element, value, bound, field of the cell, part of the message
REFUSED = [
    ([(correction("A3", 3), correction("A3", 3, 0))], "RECEIVE/AK.A3", 0, 1, ("ethernet_xml",), "jump back"),
    ([(correction("E2", 8), correction("E2", 8, 0))], "RECEIVE/EK.E2", 0, 1, ("ethernet_xml",), "HOLDON is 0"),
    ([(">FALSE<", ">TRUE<")], "CONFIG/ONLYSEND", "TRUE", "FALSE", ("ethernet_xml",), "takes no replies"),
    ([without("AK.A4")], "RECEIVE", None, None, ("ethernet_xml",), "no correction of A4"),
    ([without("EK.E3")], "RECEIVE", None, None, ("ethernet_xml",), "no correction of E3"),
    ([(correction("A4", 4), correction("A4", 4).replace("DOUBLE", "LONG"))], "RECEIVE", None, None,
     ("ethernet_xml",), "no correction of A4"),
    ([without("DEF_AIPos")], "SEND/DEF_AIPos", None, None, ("ethernet_xml",), "the positions of the axes are unknown"),
    ([without("DEF_EIPos")], "SEND/DEF_EIPos", None, None, ("ethernet_xml",), "the positions of the axes are unknown"),
    ([(">49153<", ">49152<")], "CONFIG/PORT", 49152, 49153, ("port",), "or another robot's"),
    ([(">192.168.10.10<", ">192.168.10.11<")], "CONFIG/IP_NUMBER", "192.168.10.11", "192.168.10.10", ("address",),
     "send its telegrams elsewhere"),
    ([(">192.168.10.10<", ">pc.local<")], "CONFIG/IP_NUMBER", "pc.local", "192.168.10.10", ("address",), "elsewhere"),
    ([without("Di.I2")], "SEND/Di.I2", "Di.I2", "Di.I1", ("inputs", "locked"), "no BOOL has that TAG"),
    ([('TAG="Do.O1" TYPE="BOOL"', 'TAG="Do.O1" TYPE="LONG"')], "RECEIVE/Do.O1", "Do.O1", "Do.O2, Stop",
     ("outputs", "gripper"), "no BOOL has that TAG"),
    ([without("Stop")], "RECEIVE/Stop", "Stop", "Do.O1, Do.O2", ("stop",), "no BOOL has that TAG"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("edits", "element", "value", "bound", "field", "message"),
    REFUSED,
    ids=[row[5] + row[1] for row in REFUSED],
)
def test_an_unsafe_file_is_refused_with_element_value_and_bound(
    edits: list[tuple[str, str]],
    element: str,
    value: object,
    bound: object,
    field: tuple[str, ...],
    message: str,
) -> None:
    finding = only(judge(file(*edits), CELL))
    assert finding.severity == "error"
    assert (finding.element, finding.value, finding.bound) == (element, value, bound)
    assert finding.field == field
    assert message in str(finding)
    assert str(finding).startswith(f"gr_ethernet.xml: {element}: ")


WARNED = [
    ([without("DEF_ASPos")], CELL, "SEND/DEF_ASPos", "could jump"),
    ([without("DEF_ESPos")], CELL, "SEND/DEF_ESPos", "could jump"),
    ([without("DEF_Delay")], CELL, "SEND/DEF_Delay", "late replies are not reported"),
    ([], replace(CELL, stop=None), "RECEIVE/Stop", "only hold still or fall silent"),
    (
        [('INDX="12" UNIT="0" HOLDON="1"', 'INDX="12" UNIT="0" HOLDON="0"')],
        CELL,
        "RECEIVE/Stop",
        "taken back",
    ),
    (swapped("A1", "A2"), CELL, "RECEIVE", "A1 2, A2 1"),
    (swapped("E1", "E2"), CELL, "RECEIVE", "E1 8, E2 7"),
]


@pytest.mark.parametrize(("edits", "cell", "element", "message"), WARNED, ids=[row[3] for row in WARNED])
def test_a_setting_that_makes_an_outage_worse_is_a_warning(
    edits: list[tuple[str, str]], cell: Station, element: str, message: str
) -> None:
    finding = only(judge(file(*edits), cell))
    assert (finding.severity, finding.element) == ("warning", element)
    assert message in str(finding)


def test_one_signal_for_two_purposes_is_refused() -> None:
    shared = judge(file(), replace(CELL, outputs={"gripper": "Do.O1", "changer": "Do.O1"}))
    assert (only(shared).severity, only(shared).field) == ("error", ("outputs", "changer"))
    assert "gripper and changer" in only(shared).message
    stop = judge(file(), replace(CELL, stop="Do.O1"))
    assert (only(stop).severity, only(stop).field) == ("error", ("stop",))
    assert "the output gripper" in only(stop).message


def test_two_corrections_on_one_channel_are_refused() -> None:
    with pytest.raises(EthernetConfigError, match=r"INDX 1 is used by AK\.A1"):
        file((correction("A2", 2), correction("A2", 1)))


@pytest.mark.parametrize("address", ["127.0.0.1", "127.9.9.9", "localhost", "::1"])
def test_an_emulated_cell_may_use_the_file_of_the_real_one(address: str) -> None:
    assert judge(file(), replace(CELL, address=address, port=5000)) == ()


@pytest.mark.parametrize(
    ("ip_number", "refused"), [("192.168.10.10", False), ("127.0.0.1", True), ("0.0.0.0", True)]
)
def test_a_server_on_all_interfaces_is_reached_at_every_address_except_loopbacks(
    ip_number: str, refused: bool
) -> None:
    found = judge(file((">192.168.10.10<", f">{ip_number}<")), replace(CELL, address="0.0.0.0"))
    assert [finding.element for finding in found] == ["CONFIG/IP_NUMBER"] * refused


def test_a_robot_without_external_axes_needs_none_in_the_file() -> None:
    arm = AxisMap(tuple(f"a{i}" for i in range(1, 7)), ("rad",) * 6)
    bare = file(without("DEF_EIPos"), without("DEF_ESPos"), *(without(f"EK.E{i}") for i in (1, 2, 3)))
    assert judge(bare, replace(CELL, axes=arm)) == ()


# --- contexts -------------------------------------------------------------------------------------------------

AK = "".join(f'<Input InIdx="{i}" OutObjID="ETHERNET1" OutIdx="{i}"/>' for i in range(1, 7))
EK = "".join(f'<Input InIdx="{i}" OutObjID="ETHERNET1" OutIdx="{i}"/>' for i in range(7, 10))
CONTEXT = f"""<RSIObjects>
<RSIObject ObjType="AXISCORR" ObjTypeID="33" ObjID="AXISCORR1"><Inputs>{AK}</Inputs></RSIObject>
<RSIObject ObjType="AXISCORREXT" ObjTypeID="33" ObjID="AXISCORREXT1"><Inputs>{EK}</Inputs></RSIObject>
<RSIObject ObjType="STOP" ObjTypeID="18" ObjID="STOP1">
<Inputs><Input InIdx="1" OutObjID="ETHERNET1" OutIdx="12"/></Inputs>
<Parameters><Parameter Name="Mode" ParamID="1" ParamValue="4"/></Parameters></RSIObject>
<RSIObject ObjType="ETHERNET" ObjTypeID="64" ObjID="ETHERNET1"><Parameters>
<Parameter Name="ConfigFile" ParamID="1" ParamValue="gr_ethernet.xml" IsRuntime="false"/>
<Parameter Name="Precision" ParamID="8" ParamValue="4"/>
</Parameters></RSIObject></RSIObjects>"""


def context_findings(*edits: tuple[str, str]) -> tuple[Finding, ...]:
    text = CONTEXT
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return judge_context(parse_context(text, "gr.rsi.xml"), file(), CELL)


def test_a_context_that_links_every_axis_to_its_own_correction_passes() -> None:
    assert context_findings() == ()


def test_a_context_that_moves_other_axes_is_refused_for_each() -> None:
    found = context_findings(
        ('InIdx="1" OutObjID="ETHERNET1" OutIdx="1"', 'InIdx="1" OutObjID="ETHERNET1" OutIdx="x2"'),
        ('InIdx="2" OutObjID="ETHERNET1" OutIdx="2"', 'InIdx="2" OutObjID="ETHERNET1" OutIdx="1"'),
        ("x2", "2"),
    )
    assert [(f.severity, f.element, f.bound) for f in found] == [
        ("error", "AXISCORR/CorrA1", 1),
        ("error", "AXISCORR/CorrA2", 2),
    ]
    assert "is linked to output 2 of ETHERNET1" in found[0].message


def test_an_unlinked_axis_is_refused() -> None:
    finding = only(context_findings(('<Input InIdx="9" OutObjID="ETHERNET1" OutIdx="9"/>', "")))
    assert (finding.severity, finding.element) == ("error", "AXISCORREXT/CorrE3")
    assert "is linked to nothing" in finding.message


@pytest.mark.parametrize(
    "edit",
    [('OutObjID="ETHERNET1" OutIdx="12"', 'OutObjID="ETHERNET1" OutIdx="11"'), ('ParamValue="4"/></Parameters></RSI',
     'ParamValue="1"/></Parameters></RSI')],
)  # fmt: skip
def test_a_stop_that_does_not_end_the_motion_is_refused(edit: tuple[str, str]) -> None:
    finding = only(context_findings(edit))
    assert (finding.severity, finding.field) == ("error", ("stop",))
    assert "could not end the motion" in finding.message


@pytest.mark.parametrize(("written", "value"), [("1", "1"), (None, None)])
def test_one_decimal_is_a_warning(written: str | None, value: str | None) -> None:
    old = '<Parameter Name="Precision" ParamID="8" ParamValue="4"/>'
    finding = only(context_findings((old, "" if written is None else old.replace('"4"', f'"{written}"'))))
    assert (finding.severity, finding.value, finding.bound) == ("warning", value, 4)


def test_a_context_of_rsi_4_counts_from_zero() -> None:
    text = """<RsiContext xmlns="RsiContext"><RsiObjects xmlns="RsiDriver">
    <RsiObject ObjTypeId="33" ObjType="AxisCorr" ObjId="AxisCorr_1"><Inputs>
    <Input InIdx="0" OutObjId="Ethernet_1" OutIdx="3" /></Inputs></RsiObject></RsiObjects></RsiContext>"""
    context = parse_context(text, "gr.rsix")
    (thing,) = context.of_kind("AXISCORR")
    assert thing.inputs == {1: ("Ethernet_1", 4)}
    assert context.first_external_input == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<ROOT/>", "the outermost element is <ROOT>, must be <RSIObjects> or <RsiContext>"),
        ("<RSIObjects>", "is no XML document"),
        (
            '<RSIObjects><RSIObject ObjID="A"><Input InIdx="x"/></RSIObject></RSIObjects>',
            "A: a link needs InIdx",
        ),
    ],
)
def test_an_invalid_context_is_reported(text: str, message: str) -> None:
    with pytest.raises(EthernetConfigError, match=f"c.rsi.xml: .*{message}"):
        parse_context(text, "c.rsi.xml")


# --- programs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "severity"),
    [
        ("ret = RSI_ON(#ABSOLUTE, #IPO_FAST)", None),
        ("ret = RSI_ON(#RELATIVE, #IPO)", "error"),
        ("ret = rsi_on ( #relative )", "error"),
        ("ret = RSI_ON()", "warning"),
        ("; ret = RSI_ON(#RELATIVE)", None),
        ("err = ST_AXISCORR(hAxis, 0)\nerr = ST_SETPARAM(hAxis, 1, 0)", None),
        ("err = ST_AXISCORR(hAxis,0)\nerr = ST_SETPARAM(hAxis,1,1)", "error"),
        ("err = ST_AXISCORR(hAxis, 0)\nerr = ST_SETPARAM(hOther, 1, 0)", "warning"),
        ("err = ST_AXISCORR(hAxis, 0)\nerr = ST_SETPARAM(hAxis, 1, mode)", "warning"),
        ("PTP HOME", None),
    ],
)
def test_relative_corrections_of_a_program_are_refused(line: str, severity: str | None) -> None:
    found = judge_program(f"DEF gr( )\n{line}\nEND\n", "gr.src", CELL)
    assert [finding.severity for finding in found] == [severity] * (severity is not None)
    assert all(str(finding).startswith("gr.src: ") for finding in found)


@pytest.mark.parametrize(
    ("cycle_s", "arguments", "severity", "message"),
    [
        (0.012, "#ABSOLUTE, #IPO_FAST", "error", "3 times as fast as admitted"),
        (
            0.012,
            "#ABSOLUTE",
            "error",
            "without a second argument is a cycle of 4 ms, and cycle_s of the cell is 12 ms",
        ),
        (0.004, "#absolute , #ipo", "error", "0.333 times as fast"),
        (0.012, "#ABSOLUTE, mode", "warning", "MODE, which cannot be read"),
        (0.012, "#ABSOLUTE, #IPO", None, ""),
        (0.004, "#ABSOLUTE, #ipo_fast", None, ""),
        (0.004, "#ABSOLUTE", None, ""),
    ],
)
def test_a_program_starts_rsi_with_the_cycle_of_the_cell(
    cycle_s: float, arguments: str, severity: str | None, message: str
) -> None:
    station = replace(CELL, axes=replace(AXES, krc="krc4"), cycle_s=cycle_s)
    found = judge_program(f"ret = RSI_ON({arguments})", "gr.src", station)
    assert [finding.severity for finding in found] == [severity] * (severity is not None)
    assert all(message in finding.message for finding in found)
    assert not judge_program(
        f"ret = RSI_ON({arguments})", "gr.src", replace(station, axes=AXES)
    )  # one cycle only
