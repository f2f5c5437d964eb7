"""Machine code takes for the expected telegram what Python takes for it, and nothing else."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from krc_side import AXES, XML, telegram

from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_protocol.rsi.usual_telegram import NO_JOINT, UsualTelegrams
from deltaq_services.robot_server.expected_telegram import ExpectedTelegram, is_expected

USUAL = UsualTelegrams(load_ethernet_xml(XML), AXES)
OWN = telegram(1000, delay=3)
PLACES = USUAL.places(OWN)
IS_JOINT = np.array(USUAL.order) != NO_JOINT
TOLD = np.array([float(OWN[start:end]) for start, end in PLACES])
LOWER = np.where(IS_JOINT, TOLD - 0.25, -np.inf)
UPPER = np.where(IS_JOINT, TOLD + 0.25, np.inf)
EXPECTED = ExpectedTelegram.of(OWN, PLACES, LOWER, UPPER)


def takes(expected, datagram, behind=b"7"):
    """Whether it is taken for the expected one; what lies behind it in memory makes no difference."""
    return is_expected(expected, np.frombuffer(datagram + behind, dtype=np.uint8), len(datagram))


def reference(datagram):
    """The same in Python, of the whole telegram."""
    places = USUAL.places(datagram)
    if places is None:
        return False
    last = theirs = 0
    for (start, end), (their_start, their_end), lower, upper in zip(
        PLACES, places, LOWER, UPPER, strict=True
    ):
        if OWN[last:start] != datagram[theirs:their_start]:
            return False
        if not lower <= float(datagram[their_start:their_end]) <= upper:
            return False
        last, theirs = end, their_end
    return OWN[last:] == datagram[theirs:]


def with_values(texts):
    """The telegram with other values."""
    parts, last = [], 0
    for (start, end), text in zip(PLACES, texts, strict=True):
        parts += [OWN[last:start], text]
        last = end
    return b"".join([*parts, OWN[last:]])


def written(value, decimals):
    return f"{value:.{decimals}f}".encode()


def test_the_telegram_before_it_with_its_ipoc_is_expected():
    assert takes(EXPECTED, OWN)
    assert reference(OWN)


@given(st.data())
def test_values_within_their_bounds_are_taken_however_many_decimals_they_have(data):
    texts = [
        written(data.draw(st.floats(max(low, -1e5), min(high, 1e5))), data.draw(st.integers(0, 9)))
        for low, high in zip(LOWER, UPPER, strict=True)
    ]
    datagram = with_values(texts)
    assert takes(EXPECTED, datagram) == reference(datagram)


@given(
    place=st.integers(0, len(OWN) - 1),
    cut=st.integers(0, 3),
    added=st.binary(max_size=3)
    | st.sampled_from([b"_", b".", b"-", b"+", b"e", b"1e9", b" ", b"0", b"00000000000"]),
)
def test_what_differs_anywhere_is_taken_only_if_python_takes_it(place, cut, added):
    datagram = OWN[:place] + added + OWN[place + cut :]
    assert not takes(EXPECTED, datagram) or reference(datagram)


@pytest.mark.parametrize("end", range(len(OWN)))
def test_no_beginning_of_it_is_taken(end):
    assert not takes(EXPECTED, OWN[:end], OWN[end:])


def one(text, lower=-math.inf, upper=math.inf):
    """Whether this is taken for a telegram that is one value."""
    expected = ExpectedTelegram.of(b"<1>", [(1, 2)], np.array([lower]), np.array([upper]))
    return takes(expected, b"<" + text + b">")


@pytest.mark.parametrize(
    "text", [b"0", b"-0", b"+7", b"7.", b"7.25", b"007", b"999999999999999", b"1.23456789012345"]
)
def test_a_value_is_read_as_python_reads_it_to_the_last_bit(text):
    value = float(text)
    assert one(text, value, value)
    assert not one(text, math.nextafter(value, math.inf))
    assert not one(text, -math.inf, math.nextafter(value, -math.inf))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"-",
        b".",
        b".5",
        b"--1",
        b"1-",
        b"1..2",
        b"1.2.3",
        b"1e0",
        b" 1",
        b"1 ",
        b"0x1",
        b"nan",
        b"inf",
        b"1" * 16,
    ],
)
def test_what_is_no_plain_number_is_not_taken(text):
    assert not one(text)


@given(st.integers(0, 10**15 - 1), st.integers(0, 14), st.sampled_from([b"", b"+", b"-"]))
def test_fifteen_digits_are_read_exactly(number, decimals, sign):
    digits = b"%015d" % number
    text = sign + digits[: 15 - decimals] + b"." + digits[15 - decimals :]
    assert one(text, float(text), float(text))
