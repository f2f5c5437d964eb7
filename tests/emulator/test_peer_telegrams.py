"""Telegrams in the forms that other programs for RSI write, against both codecs.

The forms were written down from what is known of these programs; no file of theirs is here. What a KRC takes from a PC
the emulated one must take; what a KRC sends the Robot Server must take. `REFUSED` is what it does not take, and why.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import RSIPI
from RSIPI.config_parser import ConfigParser
from RSIPI.xml_handler import XMLGenerator

from deltaq_cell.find import find_cell, resolve_near
from deltaq_protocol.rsi import AxisMap, KrcCodec, KrcReport, SensorCodec, TelegramError, load_ethernet_xml
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml

ARM = tuple(f"a{i}" for i in range(1, 7))
SHIPPED = resolve_near(find_cell("lab"), "fr_ethernet.xml").read_text(encoding="utf-8")
SEND = (
    '<ELEMENT TAG="Di.I1" TYPE="BOOL" INDX="1"/><ELEMENT TAG="Di.I2" TYPE="BOOL" INDX="2"/></ELEMENTS></SEND>'
)
RECEIVE = "".join(
    f'<ELEMENT TAG="Do.O{number}" TYPE="BOOL" INDX="{19 + number}" HOLDON="1"/>' for number in (1, 2)
)
FLOOR = parse_ethernet_xml(
    re.sub(r"</ELEMENTS>\s*</SEND>", SEND, SHIPPED).replace(
        '<ELEMENT TAG="Stop"', f'{RECEIVE}<ELEMENT TAG="Stop"'
    )
)
"""The floor robot's, with two digital signals each way."""
AXES = AxisMap.of(ARM, ("rad",) * 6, "krc4")
KRC = KrcCodec(FLOOR, AXES, outputs={"gripper": "Do.O1"}, stop="Stop")
PC = SensorCodec(FLOOR, AXES, inputs={"closed": "Di.I1"})
CORRECTION_DEG = [0.5, -1.25, 0.0, 0.0, 100.0, -0.0001]

REPLIES = {
    "compact, six decimals, as a client that fills a template": (
        b'<Sen Type="ImFree"><AK A1="0.500000" A2="-1.250000" A3="0.000000" A4="0.000000" A5="100.000000" '
        b'A6="-0.000100"/><Do O1="1" O2="0"/><Stop>0</Stop><IPOC>4208163634</IPOC></Sen>'
    ),
    "the maker's client: blocks in the file's order, a text for the pendant first": (
        b'<Sen Type="ImFree"><EStr>ready</EStr><AK A1="0.5000" A2="-1.2500" A3="0.0000" A4="0.0000" A5="100.0000" '
        b'A6="-0.0001" /><IPOC>4208163634</IPOC></Sen>'
    ),
    "a printer of XML documents: no decimals where none are needed, a space before the end": (
        b'<Sen Type="ImFree"><AK A1="0.5" A2="-1.25" A3="0" A4="0" A5="100" A6="-0.0001" /><Do O1="1" O2="0" />'
        b"<IPOC>4208163634</IPOC></Sen>"
    ),
    "indented, a line an element, Windows' ends of lines": (
        b'<Sen Type="ImFree">\r\n  <AK A1="0.5" A2="-1.25" A3="0.0" A4="0.0" A5="100.0" A6="-0.0001"/>\r\n'
        b"  <IPOC>4208163634</IPOC>\r\n</Sen>\r\n"
    ),
    "attributes in another order, and apostrophes": (
        b"<Sen Type='ImFree'><AK A6='-0.0001' A5='100' A4='0' A3='0' A2='-1.25' A1='0.5'/><IPOC>4208163634</IPOC></Sen>"
    ),
    "the time stamp first, and elements that the file does not have": (
        b'<Sen Type="ImFree"><IPOC>4208163634</IPOC><Tech T21="0.0"/><AK A1="0.5" A2="-1.25" A3="0.0" A4="0.0" '
        b'A5="100.0" A6="-0.0001"/><RKorr X="0.0" Y="0.0"/></Sen>'
    ),
    "a number that C++ writes in the shortest form": (
        b'<Sen Type="ImFree"><AK A1="5e-1" A2="-1.25" A3="0" A4="-0" A5="1e+02" A6="-1e-04"/>'
        b"<IPOC>4208163634</IPOC></Sen>"
    ),
    "a number without a leading nought, and a plus sign": (
        b'<Sen Type="ImFree"><AK A1=".5" A2="-1.25" A3="+0.0" A4="0." A5="100.0" A6="-.0001"/>'
        b"<IPOC>4208163634</IPOC></Sen>"
    ),
    "an end of C's string behind it": (
        b'<Sen Type="ImFree"><AK A1="0.5" A2="-1.25" A3="0.0" A4="0.0" A5="100.0" A6="-0.0001"/>'
        b"<IPOC>4208163634</IPOC></Sen>\0"
    ),
}
TELEGRAMS = {
    "a KRC, four decimals": (
        b'<Rob Type="KUKA"><RIst X="1400.0000" Y="0.0000" Z="900.0000" A="0.0000" B="90.0000" C="0.0000"/>'
        b'<AIPos A1="0.5000" A2="-1.2500" A3="0.0000" A4="0.0000" A5="100.0000" A6="-0.0001"/>'
        b'<ASPos A1="0.0000" A2="0.0000" A3="0.0000" A4="0.0000" A5="0.0000" A6="0.0000"/><Delay D="3"/>'
        b'<Di I1="1" I2="0"/><IPOC>4208163634</IPOC></Rob>'
    ),
    "a simulator that writes TYPE, and a line an element": (
        b'<Rob TYPE="KUKA">\n<RIst X="1400.0" Y="0.0" Z="900.0" A="0.0" B="90.0" C="0.0"/>\n'
        b'<AIPos A1="0.5" A2="-1.25" A3="0.0" A4="0.0" A5="100.0" A6="-0.0001"/>\n'
        b'<ASPos A1="0.0" A2="0.0" A3="0.0" A4="0.0" A5="0.0" A6="0.0"/>\n<Delay D="3"/>\n'
        b'<Di I1="1" I2="0"/>\n<IPOC>4208163634</IPOC>\n</Rob>\n'
    ),
    "a printer of XML documents": (
        b'<Rob Type="KUKA"><RIst X="1400" Y="0" Z="900" A="0" B="90" C="0" />'
        b'<AIPos A1="0.5" A2="-1.25" A3="0" A4="0" A5="100" A6="-0.0001" />'
        b'<ASPos A1="0" A2="0" A3="0" A4="0" A5="0" A6="0" /><Delay D="3" /><Di I1="1" I2="0" />'
        b"<IPOC>4208163634</IPOC></Rob>"
    ),
}
REFUSED = {
    "elements in another order: a KRC keeps the order of its file, and the maker's client reads by byte offset": (
        b'<Rob Type="KUKA"><AIPos A1="0.5" A2="-1.25" A3="0" A4="0" A5="100" A6="-0.0001"/>'
        b'<RIst X="1400" Y="0" Z="900" A="0" B="90" C="0"/>'
        b'<ASPos A1="0" A2="0" A3="0" A4="0" A5="0" A6="0"/><Delay D="3"/><Di I1="1" I2="0"/>'
        b"<IPOC>4208163634</IPOC></Rob>"
    ),
    "an element twice: one of the two is wrong": TELEGRAMS["a printer of XML documents"].replace(
        b"<ASPos", b'<AIPos A1="9" A2="9" A3="9" A4="9" A5="9" A6="9" /><ASPos'
    ),
}


@pytest.mark.parametrize("form", REPLIES)
def test_the_emulated_krc_accepts_the_reply_format_of(form: str) -> None:
    reply = KRC.decode(REPLIES[form])
    assert (reply.type, reply.ipoc) == ("ImFree", 4208163634)
    assert reply.present.all()
    assert np.rad2deg(reply.correction) == pytest.approx(CORRECTION_DEG, abs=1e-9)
    assert not reply.stop
    assert reply.outputs.get("gripper", True)


@pytest.mark.parametrize("form", TELEGRAMS)
def test_the_robot_server_accepts_the_telegram_format_of(form: str) -> None:
    telegram = PC.decode(TELEGRAMS[form])
    assert (telegram.ipoc, telegram.delay, telegram.inputs) == (4208163634, 3, {"closed": True})
    assert telegram.q is not None
    assert np.rad2deg(telegram.q) == pytest.approx(CORRECTION_DEG, abs=1e-9)


@pytest.mark.parametrize("why", REFUSED)
def test_the_robot_server_refuses(why: str) -> None:
    with pytest.raises(TelegramError):
        PC.decode(REFUSED[why])


def test_the_emulated_krc_and_the_robot_server_accept_each_other() -> None:
    q = np.deg2rad(CORRECTION_DEG)
    telegram = PC.decode(KRC.encode(KrcReport(7, q, 0 * q, (0.0,) * 6, (0.0,) * 6, 0, {})))
    assert telegram.q == pytest.approx(q, abs=1e-6)
    assert KRC.decode(PC.encode(7, q)).correction == pytest.approx(q, abs=1e-7)


def rsipi_telegram(file: Path) -> bytes:
    """What RSIPI's own emulated controller sends for a configuration."""
    state = dict(ConfigParser(str(file)).send_variables)
    state.pop("IPOC", None)
    return XMLGenerator.generate_receive_xml(state | {"IPOC": 123456}).encode()


@pytest.mark.parametrize(("robot", "joints"), [("fr", ARM), ("gr", ("e1", "e2", "e3", *ARM))])
def test_the_robot_server_accepts_telegrams_of_the_controller_of_rsipi_with_our_files(
    robot: str, joints: tuple[str, ...]
) -> None:
    file = resolve_near(find_cell("lab"), f"{robot}_ethernet.xml")
    axes = AxisMap.of(joints, ("m",) * (len(joints) - 6) + ("rad",) * 6, "krc4")
    telegram = SensorCodec(load_ethernet_xml(file), axes).decode(rsipi_telegram(file))
    assert telegram.ipoc == 123456
    assert telegram.q is not None
    assert not telegram.q.any()


def test_the_controller_of_rsipi_moves_tech_to_the_end_unlike_any_krc() -> None:
    """Its file has DEF_Tech before DiL; a real controller keeps that order."""
    file = Path(RSIPI.context("joints"))
    config = load_ethernet_xml(file)
    theirs = rsipi_telegram(file)
    order = [element.group for element in config.send]
    assert order.index("Tech") < order.index("DiL")
    assert theirs.index(b"<DiL>") < theirs.index(b"<Tech ")
    with pytest.raises(TelegramError, match="order is not the order of that file"):
        SensorCodec(config, AXES).decode(theirs)
    tech = theirs[theirs.index(b"<Tech ") : theirs.index(b"<IPOC>")]
    in_order = theirs.replace(tech, b"").replace(b"<DiL>", tech + b"<DiL>")
    assert SensorCodec(config, AXES).decode(in_order).ipoc == 123456
