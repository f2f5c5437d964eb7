"""What is read of a telegram without an array is what the codec reads of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from krc_side import AXES, CELL, FR, XML, telegram

from deltaq_protocol.rsi import TelegramError, load_ethernet_xml
from deltaq_protocol.rsi.layout import MAX_IPOC
from deltaq_protocol.rsi.usual_telegram import UsualTelegrams
from deltaq_services.robot_server.krc_file import sensor_codec

CODEC = sensor_codec(CELL, "fr", XML)
USUAL = UsualTelegrams(load_ethernet_xml(XML), AXES)
OWN = telegram(1000, delay=3)


def test_a_telegram_is_its_joints_and_what_stays():
    joints = USUAL.joints(OWN)
    told = [float(joints[USUAL.order.index(joint)]) for joint in range(6)]
    assert told == [round(float(q), 4) for q in FR.home * AXES.reported]
    assert b'<Delay D="3"/>' in USUAL.steady(OWN)
    assert USUAL.ipoc(OWN) == 1000
    assert OWN.endswith(USUAL.end(OWN, 1000))


@given(
    place=st.integers(0, len(OWN) - 1),
    cut=st.integers(0, 3),
    added=st.binary(max_size=3) | st.sampled_from([b"_", b".", b"-", b"e", b"nan", b"1e9", b" ", b"\n"]),
)
def test_what_is_read_here_the_codec_reads_with_the_same_numbers(place, cut, added):
    datagram = OWN[:place] + added + OWN[place + cut :]
    joints = USUAL.joints(datagram)
    if joints is None:
        return
    if USUAL.ipoc(datagram) > MAX_IPOC:
        with pytest.raises(TelegramError, match="32 bit"):
            CODEC.decode(datagram)
        return
    decoded = CODEC.decode(datagram)
    told = [float(joints[USUAL.order.index(joint)]) for joint in range(6)]
    assert np.abs(decoded.q * AXES.reported - told).max() <= 1e-9 * np.abs(told).max()
    assert decoded.ipoc == USUAL.ipoc(datagram)
    if USUAL.steady(datagram) == USUAL.steady(OWN):
        assert decoded.delay == 3
        assert (decoded.q_programmed == CODEC.decode(OWN).q_programmed).all()
