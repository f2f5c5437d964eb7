from pathlib import Path

import pytest

import deltaq_deploy
from deltaq_protocol.rsi import AxisMap, EthernetConfigError, load_ethernet_xml
from deltaq_protocol.rsi.ethernet_xml import ElementType, parse_ethernet_xml

KRC = Path(deltaq_deploy.__file__).parent / "krc"
VALID = """
<ROOT>
  <CONFIG>
    <IP_NUMBER>192.168.1.2</IP_NUMBER><PORT>49152</PORT>
    <SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND>
  </CONFIG>
  <SEND><ELEMENTS>
    <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL" />
    <ELEMENT TAG="Di.I1" TYPE="BOOL" INDX="1" />
  </ELEMENTS></SEND>
  <RECEIVE><ELEMENTS>
    <ELEMENT TAG="DEF_EStr" TYPE="STRING" INDX="INTERNAL" />
    <ELEMENT TAG="AK.A1" TYPE="DOUBLE" INDX="1" HOLDON="1" />
    <ELEMENT TAG="AK.A2" TYPE="DOUBLE" INDX="2" HOLDON="0" />
  </ELEMENTS></RECEIVE>
</ROOT>
"""


@pytest.mark.parametrize(("robot", "port", "channels"), [("fr", 49152, 6), ("gr", 49153, 9)])
def test_the_files_for_the_real_controllers_can_be_loaded(robot: str, port: int, channels: int) -> None:
    config = load_ethernet_xml(KRC / f"{robot}_ethernet.xml")
    assert (config.port, config.sentype, config.only_send) == (port, "ImFree", False)
    corrections = [element for element in config.receive if element.type is ElementType.DOUBLE]
    assert len(corrections) == channels
    assert all(element.hold_on for element in corrections)


def test_every_element_is_read_in_its_order() -> None:
    config = parse_ethernet_xml(VALID)
    assert [element.tag for element in config.receive] == ["DEF_EStr", "AK.A1", "AK.A2"]
    assert [element.channel for element in config.receive] == [None, 1, 2]
    assert [element.hold_on for element in config.receive] == [False, True, False]
    assert config.send[0].internal == "AIPos"
    assert (config.send[1].group, config.send[1].attribute) == ("Di", "I1")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("49152", "70000", r"lab_ethernet\.xml: CONFIG/PORT is 70000, allowed is 1 to 65535"),
        ("49152", "x", r"CONFIG/PORT is 'x'"),
        ("192.168.1.2", "", r"CONFIG/IP_NUMBER is ''"),
        (">ImFree<", ">I&lt;m<", r"CONFIG/SENTYPE is 'I<m', allowed is up to 64"),
        ("</PORT>", "</PORT><PROTOCOL>TCP</PROTOCOL>", r"CONFIG/PROTOCOL is 'TCP', allowed is UDP"),
        (">FALSE<", ">NO<", r"CONFIG/ONLYSEND is 'NO', allowed is TRUE or FALSE"),
        ('HOLDON="0"', 'HOLDON="2"', r"RECEIVE element 3 \(AK\.A2\): HOLDON is '2', allowed is 1"),
        (' HOLDON="0"', "", r"RECEIVE element 3 \(AK\.A2\): HOLDON is ''"),
        ('"AK.A2"', '"AK.A1"', r"RECEIVE element 3 \(AK\.A1\): TAG comes twice"),
        ('"AK.A2"', '"AK 2"', r"TAG is 'AK 2', allowed is NAME, NAME\.ATTRIBUTE or DEF_NAME"),
        ('"AK.A2"', '"IPOC"', r"TAG is 'IPOC'"),
        ('"AK.A2"', '"AK"', r"AK is both an element with text and one with attributes \(AK\.A1\)"),
        ('INDX="2"', 'INDX="65"', r"INDX is '65', allowed is 1 to 64"),
        ('INDX="2"', 'INDX="1"', r"INDX 1 is used by AK\.A1"),
        ('"BOOL"', '"BYTE"', r"SEND element 2 \(Di\.I1\): TYPE is 'BYTE', allowed is BOOL, LONG"),
        ('"DEF_AIPos"', '"DEF_APos"', r"SEND element 1 \(DEF_APos\): not known in SEND, allowed is DEF_RIst"),
        (
            'INDX="INTERNAL" />\n    <ELEMENT TAG="Di',
            'INDX="9" />\n    <ELEMENT TAG="Di',
            "must have INTERNAL",
        ),
        ("</ROOT>", "", "is no XML document"),
        ("ROOT>", "RSI>", r"the outermost element is <RSI>, must be <ROOT>"),
    ],
)
def test_a_forbidden_value_is_reported_with_file_element_and_bound(old: str, new: str, message: str) -> None:
    assert old in VALID
    with pytest.raises(EthernetConfigError, match=message):
        parse_ethernet_xml(VALID.replace(old, new), "lab_ethernet.xml")


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(EthernetConfigError, match="cannot be read"):
        load_ethernet_xml(tmp_path / "none.xml")
    (tmp_path / "binary.xml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(EthernetConfigError, match="cannot be read"):
        load_ethernet_xml(tmp_path / "binary.xml")


@pytest.mark.parametrize(
    ("joints", "units"),
    [
        (("a1", "a1"), ("rad", "rad")),
        (("a7",), ("rad",)),
        (("a1",), ("m",)),
        (("a1",), ()),
        (("x",), ("rad",)),
    ],
)
def test_a_joint_without_an_rsi_axis_is_refused(joints: tuple[str, ...], units: tuple[str, ...]) -> None:
    with pytest.raises(EthernetConfigError, match=r"allowed are|one unit for each"):
        AxisMap.of(joints, units, "krc4")  # type: ignore[arg-type]  # the wrong unit is the point


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "UTF-16"])
def test_a_file_is_read_in_its_declared_encoding(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "cell_ethernet.xml"
    file.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?><!-- für -->{VALID}'.encode(encoding))
    assert load_ethernet_xml(file) == parse_ethernet_xml(VALID, file.name)
