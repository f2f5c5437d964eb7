"""What is read of a telegram without an array is what the codec reads of it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from krc_side import AXES, CELL, FR, XML, telegram

from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_protocol.rsi.usual_telegram import UsualTelegrams
from deltaq_services.robot_server.krc_file import sensor_codec

CODEC = sensor_codec(CELL, "fr", XML)
USUAL = UsualTelegrams(load_ethernet_xml(XML), AXES)
OWN = telegram(1000, delay=3)


def joints(datagram):
    """The joints (n,) as they were written; None if it is no telegram in the usual layout."""
    places = USUAL.places(datagram)
    if places is None:
        return None
    told = dict(zip(USUAL.order, (datagram[start:end] for start, end in places), strict=True))
    return [float(told[joint]) for joint in range(6)]


def between(datagram):
    """What stands between the values that vary."""
    kept, last = [], 0
    for start, end in USUAL.places(datagram):
        kept.append(datagram[last:start])
        last = end
    return [*kept, datagram[last:]]


def test_a_telegram_is_its_joints_and_what_stays():
    assert joints(OWN) == [round(float(q), 4) for q in FR.home * AXES.reported]
    assert b'<Delay D="3"/>' in b"".join(between(OWN))
    assert USUAL.ipoc(OWN) == 1000
    assert USUAL.with_ipoc(OWN, 1000) == OWN
    assert USUAL.ipoc(USUAL.with_ipoc(OWN, 7)) == 7


@given(
    place=st.integers(0, len(OWN) - 1),
    cut=st.integers(0, 3),
    added=st.binary(max_size=3) | st.sampled_from([b"_", b".", b"-", b"e", b"nan", b"1e9", b" ", b"\n"]),
)
def test_what_is_read_here_the_codec_reads_with_the_same_numbers(place, cut, added):
    datagram = OWN[:place] + added + OWN[place + cut :]
    told = joints(datagram)
    if told is None:
        return
    decoded = CODEC.decode(datagram)
    assert np.abs(decoded.q * AXES.reported - told).max() <= 1e-9 * np.abs(told).max()
    assert decoded.ipoc == USUAL.ipoc(datagram)
    if between(datagram) == between(OWN):
        assert decoded.delay == 3
        assert (decoded.q_programmed == CODEC.decode(OWN).q_programmed).all()
