"""A telegram that is read by its pattern is one that the codec reads, with the same numbers."""

import re

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from krc_side import AXES, CELL, FR, XML, telegram

from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_protocol.rsi.layout import usual_telegram
from deltaq_services.robot_server.rsi_driver import sensor_codec

CODEC = sensor_codec(CELL, "fr", XML)
PATTERN, PROGRAMMED = usual_telegram(load_ethernet_xml(XML))
OWN = telegram(1000, delay=3)


def value(datagram, name):
    """A value as it was written."""
    return re.search(rb"[ <]" + name + rb'(?:="|>)([^"<]*)["<]', datagram)[1]


def test_only_a_complete_telegram_of_the_controller_fits():
    assert re.fullmatch(PATTERN.encode(), OWN)
    assert not re.fullmatch(PATTERN.encode(), OWN[:-1])
    assert all(OWN.count(element.encode()) == 1 for element in PROGRAMMED)


@given(
    place=st.integers(0, len(OWN) - 1),
    cut=st.integers(0, 3),
    added=st.binary(max_size=3) | st.sampled_from([b"_", b".", b"-", b"e", b"nan", b"1e9", b" ", b"\n"]),
)
def test_a_fitting_telegram_is_read_by_the_codec_with_the_same_numbers(place, cut, added):
    datagram = OWN[:place] + added + OWN[place + cut :]
    if not re.fullmatch(PATTERN.encode(), datagram):
        return
    ipoc = int(value(datagram, b"IPOC"))
    decoded = CODEC.decode(datagram)
    assert decoded.is_usual
    assert CODEC._usual.fullmatch(datagram).groups() == CODEC._pattern.fullmatch(datagram).groups()
    assert (decoded.ipoc, decoded.delay) == (ipoc, float(value(datagram, b"D")))
    joints = datagram.partition(b"<AIPos ")[2].partition(b"/>")[0]
    told = np.array([float(value(b" " + joints, b"A%d" % axis)) for axis in range(1, 7)])
    assert np.abs(decoded.q * AXES.reported - told).max() <= 1e-9 * max(1.0, np.abs(told).max())
    assert len(decoded.q) == len(FR.joints)
