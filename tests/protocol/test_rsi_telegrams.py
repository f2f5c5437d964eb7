import math
import re
from collections.abc import Callable
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_deploy.rsi.listen import look_at
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.rsi import (
    AxisMap,
    EthernetConfig,
    EthernetConfigError,
    KrcCodec,
    KrcReport,
    SensorCodec,
    TelegramError,
)
from deltaq_protocol.rsi.ethernet_xml import parse_ethernet_xml
from deltaq_protocol.rsi.krc_codec import SensorTelegram, pose_from_matrix

ARM = tuple(f"a{i}" for i in range(1, 7))
NINE = ("e1", "e2", "e3", *ARM)


def element(tag: str, kind: str = "DOUBLE", index: object = "INTERNAL", hold_on: int = 1) -> str:
    return f'<ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}" HOLDON="{hold_on}"/>'


def make_config(send: str, receive: str, sentype: str = "ImFree") -> EthernetConfig:
    return parse_ethernet_xml(
        f"<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>49152</PORT><SENTYPE>{sentype}</SENTYPE>"
        f"<ONLYSEND>FALSE</ONLYSEND></CONFIG><SEND><ELEMENTS>{send}</ELEMENTS></SEND>"
        f"<RECEIVE><ELEMENTS>{receive}</ELEMENTS></RECEIVE></ROOT>"
    )


# the maker's canonical telegram
CANONICAL_SEND = (
    element("DEF_RIst") + element("DEF_AIPos") + element("DEF_EIPos") + element("DEF_Delay", "LONG")
)
ARM_CORRECTION = "".join(element(f"AK.A{i}", index=i) for i in range(1, 7))
EXTERNAL_CORRECTION = "".join(element(f"EK.E{i}", index=6 + i) for i in range(1, 4))
CANONICAL = make_config(CANONICAL_SEND, ARM_CORRECTION + EXTERNAL_CORRECTION)
ARM_AXES = AxisMap.of(ARM, ("rad",) * 6, "krc4")
GANTRY_AXES = AxisMap.of(NINE, ("m",) * 3 + ("rad",) * 6, "krc4")
Q_HOME = np.deg2rad([0.0, -90.0, 90.0, 0.0, 45.5, -12.25])

FROM_KRC = (
    b'<Rob Type="KUKA"><RIst X="1023.4000" Y="-5.2500" Z="1400.0000" A="-90.0000" B="0.5000" C="180.0000"/>'
    b'<AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="45.5000" A6="-12.2500"/>'
    b'<EIPos E1="0.0000" E2="0.0000" E3="0.0000" E4="0.0000" E5="0.0000" E6="0.0000"/>'
    b'<Delay D="0"/><IPOC>4208163634</IPOC></Rob>'
)
TO_KRC = (
    b'<Sen Type="ImFree"><AK A1="0.000000" A2="-1.500000" A3="0.250000" A4="0.000000" A5="0.000000"'
    b' A6="0.000001"/><EK E1="0.000000" E2="0.000000" E3="0.000000"/><IPOC>4208163634</IPOC></Sen>'
)


def with_text(reply: bytes, text: str) -> bytes:
    """A reply with a text for the pendant, which our PC leaves empty."""
    return reply.replace(b"<EStr></EStr>", f"<EStr>{escape(text)}</EStr>".encode())


def report(q: np.ndarray, pose: tuple[float, ...] = (0.0,) * 6, delay: int = 0, **inputs: bool) -> KrcReport:
    return KrcReport(4208163634, q, q, pose, pose, delay, inputs)


def test_the_telegram_of_the_controller_equals_the_compact_form_of_kuka() -> None:
    pose = (1.0234, -0.00525, 1.4, -math.pi / 2, math.radians(0.5), math.pi)
    assert KrcCodec(CANONICAL, ARM_AXES).encode(report(Q_HOME, pose)) == FROM_KRC


def test_the_reply_equals_the_example_of_kuka() -> None:
    correction = np.deg2rad([0.0, -1.5, 0.25, 0.0, 0.0, 1e-6])
    assert SensorCodec(CANONICAL, ARM_AXES).encode(4208163634, correction) == TO_KRC


def test_the_pc_reads_joints_delay_and_ipoc_in_si_units() -> None:
    telegram = SensorCodec(CANONICAL, ARM_AXES).decode(FROM_KRC)
    assert telegram.ipoc == 4208163634
    assert telegram.q == pytest.approx(Q_HOME, abs=1e-9)
    assert telegram.delay == 0
    assert telegram.inputs == {}
    assert telegram.q_programmed is None


def test_the_controller_reads_corrections_in_si_units() -> None:
    telegram = KrcCodec(CANONICAL, ARM_AXES).decode(TO_KRC)
    assert (telegram.type, telegram.ipoc) == ("ImFree", 4208163634)
    assert telegram.correction == pytest.approx(np.deg2rad([0, -1.5, 0.25, 0, 0, 1e-6]), abs=1e-15)
    assert telegram.present.all()


def test_precision_sets_the_decimals_of_the_controller() -> None:
    telegram = KrcCodec(CANONICAL, ARM_AXES, precision=1).encode(report(Q_HOME))
    assert b'A5="45.5" A6="-12.2"' in telegram


def test_prismatic_axes_come_first_and_are_millimetres_on_the_wire() -> None:
    q = np.array([0.532, 3.532, -0.892, *Q_HOME])
    telegram = KrcCodec(CANONICAL, GANTRY_AXES).encode(report(q))
    assert b'<EIPos E1="532.0000" E2="3532.0000" E3="-892.0000" E4="0.0000" ' in telegram
    assert b'A5="45.5000"' in telegram
    sensor = SensorCodec(CANONICAL, GANTRY_AXES)
    assert sensor.decode(telegram).q == pytest.approx(q, abs=1e-6)
    reply = sensor.encode(1, np.array([0.001, -0.002, 0.0, math.radians(3.0), 0, 0, 0, 0, 0]))
    assert b'<EK E1="1.000000" E2="-2.000000" E3="0.000000"/>' in reply
    assert b'<AK A1="3.000000"' in reply


def test_a_kr_c2_reports_linear_axes_times_180_over_pi_but_takes_millimetres() -> None:
    axes = AxisMap.of(NINE, ("m",) * 3 + ("rad",) * 6, "krc2")
    q = np.array([1.0, 0.0, 0.0, *Q_HOME])
    telegram = KrcCodec(CANONICAL, axes).encode(report(q))
    assert b'<EIPos E1="57295.7795" E2' in telegram
    sensor = SensorCodec(CANONICAL, axes)
    assert sensor.decode(telegram).q == pytest.approx(q, abs=1e-6)
    assert b'<EK E1="1000.000000" ' in sensor.encode(1, q)


def test_the_first_telegram_of_a_kr_c2_has_only_its_ipoc() -> None:
    first = KrcCodec.encode_ipoc_only(77)
    assert first == b'<Rob Type="KUKA"><IPOC>77</IPOC></Rob>'
    assert SensorCodec(CANONICAL, ARM_AXES).decode(first) == (77, None, None, {}, None, False)


def test_corrections_have_the_tags_of_the_file() -> None:
    receive = element("DEF_EStr", "STRING", hold_on=0)
    receive += "".join(element(f"AKorr.A{i}", index=i) for i in range(1, 7))
    receive += element("FREE", "LONG", 20) + element("Stop", "LONG", 21)
    sensor = SensorCodec(make_config(CANONICAL_SEND, receive, "Server"), ARM_AXES)
    assert sensor.encode(5, np.zeros(6)) == (
        b'<Sen Type="Server"><EStr></EStr>'
        b'<AKorr A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000" A5="0.000000" A6="0.000000"/>'
        b"<Stop>0</Stop><IPOC>5</IPOC></Sen>"
    )


def test_text_of_a_pc_reaches_the_controller() -> None:
    config = make_config(CANONICAL_SEND, element("DEF_EStr", "STRING", hold_on=0) + ARM_CORRECTION)
    telegram = with_text(SensorCodec(config, ARM_AXES).encode(5, np.zeros(6)), "a < b")
    assert KrcCodec(config, ARM_AXES).decode(telegram).text == "a < b"


def test_digital_signals_are_read_by_their_tags_in_any_order() -> None:
    config = make_config(
        CANONICAL_SEND + element("Di.I1", "BOOL", 1) + element("Di.I2", "BOOL", 2),
        ARM_CORRECTION + element("Do.O1", "BOOL", 7) + element("Do.O2", "BOOL", 8, hold_on=0),
    )
    inputs = {"changed": "Di.I2", "closed": "Di.I1"}
    outputs = {"gripper": "Do.O1", "changer": "Do.O2"}
    sensor = SensorCodec(config, ARM_AXES, inputs=inputs, outputs=outputs)
    krc = KrcCodec(config, ARM_AXES, inputs=inputs, outputs=outputs)
    telegram = krc.encode(report(Q_HOME, changed=True))
    assert b'<Di I1="0" I2="1"/>' in telegram
    assert sensor.decode(telegram).inputs == {"closed": False, "changed": True}
    reply = sensor.encode(1, np.zeros(6), {"gripper": True})
    assert b'<Do O1="1" O2="0"/>' in reply
    assert krc.decode(reply).outputs == {"gripper": True, "changer": False}
    assert krc.output_hold_on == {"gripper": True, "changer": False}
    with pytest.raises(TelegramError, match=r"outputs \['door'\] are not known"):
        sensor.encode(1, np.zeros(6), {"door": True})


def test_a_configuration_that_cannot_move_the_robot_is_refused_with_the_remedy() -> None:
    with pytest.raises(EthernetConfigError, match=r"RECEIVE has no correction of E1, E2, E3; .* EK\.E1"):
        SensorCodec(make_config(CANONICAL_SEND, ARM_CORRECTION), GANTRY_AXES)
    config = make_config(element("DEF_AIPos"), ARM_CORRECTION + EXTERNAL_CORRECTION)
    with pytest.raises(EthernetConfigError, match=r"SEND does not have DEF_EIPos, which reports joint e1"):
        SensorCodec(config, GANTRY_AXES)
    with pytest.raises(EthernetConfigError, match="RECEIVE has AK and BK, each of which could be"):
        SensorCodec(make_config(CANONICAL_SEND, ARM_CORRECTION + element("BK.A1", index=9)), ARM_AXES)
    with pytest.raises(
        EthernetConfigError, match=r"SEND has no BOOL signal Di\.I1, which the cell names for closed"
    ):
        SensorCodec(CANONICAL, ARM_AXES, inputs={"closed": "Di.I1"})
    config = make_config(CANONICAL_SEND, ARM_CORRECTION + element("Do.O1", "BOOL", 7))
    with pytest.raises(EthernetConfigError, match=r"Do\.O1 of RECEIVE is named for gripper and for changer"):
        SensorCodec(config, ARM_AXES, outputs={"gripper": "Do.O1", "changer": "Do.O1"})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9, -1e9])
def test_a_correction_that_cannot_be_written_is_refused(value: float) -> None:
    with pytest.raises(TelegramError, match="correction of A3 is"):
        SensorCodec(CANONICAL, ARM_AXES).encode(1, np.array([0, 0, value, 0, 0, 0.0]))
    with pytest.raises(TelegramError, match="has 6 elements, got 9"):
        SensorCodec(CANONICAL, ARM_AXES).encode(1, np.zeros(9))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b'<Rob Type="KUKA">', b'<Rob Type="OTHER">', "starts with <Rob Type="),
        (b'A3="90.0000"', b'A3="nan"', "A3 of AIPos is missing or no number, though ethernet.xml lists it"),
        (b' A6="-12.2500"', b"", "A6 of AIPos is missing"),
        (b'<Delay D="0"/>', b"", "D of Delay is missing"),
        (b"<IPOC>4208163634", b"<IPOC>x", "IPOC is missing"),
        (b"<IPOC>", b"<Extra/><IPOC>", "something in the telegram that ethernet.xml does not list"),
        (b"</Rob>", b"</Rob>" + b" " * 5000, "at most 4096 bytes"),
    ],
)
def test_each_fault_of_a_telegram_is_named(old: bytes, new: bytes, message: str) -> None:
    with pytest.raises(TelegramError, match=re.escape(message)):
        SensorCodec(CANONICAL, ARM_AXES).decode(FROM_KRC.replace(old, new))


def test_an_ipoc_beyond_32_bit_is_read_unchanged() -> None:
    for ipoc in (2**32, 123645634563, 10**20 - 1):
        assert (
            SensorCodec(CANONICAL, ARM_AXES).decode(FROM_KRC.replace(b"4208163634", b"%d" % ipoc)).ipoc
            == ipoc
        )


def test_names_that_begin_with_a_digit_are_written_and_read_at_both_ends() -> None:
    own = element("Out.01", "BOOL", 7) + element("2nd", "BOOL", 8)
    config = make_config(CANONICAL_SEND + own, ARM_CORRECTION + own)
    tags = {"one": "Out.01", "two": "2nd"}
    krc, pc = KrcCodec(config, ARM_AXES, tags, tags), SensorCodec(config, ARM_AXES, tags, tags)
    for state in ({"one": True, "two": False}, {"one": False, "two": True}):
        telegram = krc.encode(KrcReport(5, Q_HOME, Q_HOME, (0.0,) * 6, (0.0,) * 6, 0, state))
        assert b'<Out 01="%d"/><2nd>%d</2nd>' % tuple(state.values()) in telegram
        assert pc.decode(telegram).inputs == state
        assert set(look_at(telegram).elements) >= {"Out.01", "2nd"}
        reply = pc.encode(5, np.full(6, 0.01), state)
        # not as our own end writes it, so read as a KRC reads any reply
        loose = reply.replace(b"/>", b" />\n").replace(b"<AK", b"<Note x='1 01=2'/><AK")
        for form in (reply, loose):
            read = krc.decode(form)
            assert read.outputs == state
            assert read.correction == pytest.approx(0.01)


def test_white_space_between_elements_does_not_disturb_the_pc() -> None:
    loose = FROM_KRC.replace(b"/>", b" />\r\n").replace(b"Type", b"TYPE") + b"\r\n"
    assert SensorCodec(CANONICAL, ARM_AXES).decode(loose).q == pytest.approx(Q_HOME, abs=1e-9)


@pytest.mark.parametrize(
    ("datagram", "message"),
    [
        (b"", "no XML document"),
        (b"\xff\x00", "only plain ASCII"),
        (TO_KRC[:-3], "no XML document"),
        (TO_KRC.replace(b"Sen", b"Rob"), "a reply is a <Sen Type="),
        (TO_KRC.replace(b' Type="ImFree"', b""), "a reply is a <Sen Type="),
        (TO_KRC.replace(b"4208163634", b"-1"), "IPOC is '-1'"),
        (TO_KRC.replace(b"4208163634", b"4294967296"), "IPOC is '4294967296'"),
        (TO_KRC.replace(b"-1.500000", b"NaN"), "AK.A2 is 'NaN', allowed is a decimal number"),
        (TO_KRC.replace(b"-1.500000", b"1e999"), "AK.A2 is '1e999'"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]>' + TO_KRC, "only plain ASCII elements"),
        (b"<" * 5000, "5000 bytes long, at most 4096"),
    ],
)
def test_each_fault_of_a_reply_is_named(datagram: bytes, message: str) -> None:
    with pytest.raises(TelegramError, match=re.escape(message)):
        KrcCodec(CANONICAL, ARM_AXES).decode(datagram)


def test_the_controller_accepts_elements_in_any_order_and_detects_missing_ones() -> None:
    telegram = KrcCodec(CANONICAL, GANTRY_AXES).decode(
        b'<Sen Type="X">\n <IPOC>7</IPOC><Other q="1"/> <AK A2="1.0" A1="2" /></Sen>'
    )
    assert telegram.present.tolist() == [False] * 3 + [True, True] + [False] * 4
    assert telegram.correction[3:5] == pytest.approx(np.deg2rad([2.0, 1.0]))


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    telegram = bytearray(draw(st.sampled_from([FROM_KRC, TO_KRC])))
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(telegram) - 1))
        if draw(st.booleans()):
            telegram[place] = draw(st.integers(0, 255))
        else:
            del telegram[place : place + draw(st.integers(1, 20))]
            telegram = telegram or bytearray(b"<")
    return bytes(telegram)


@given(damaged() | st.binary(max_size=300))
def test_a_damaged_telegram_is_decoded_to_finite_numbers_or_refused(datagram: bytes) -> None:
    for codec in (SensorCodec(CANONICAL, ARM_AXES), KrcCodec(CANONICAL, ARM_AXES)):
        try:
            telegram = codec.decode(datagram)
        except ProtocolError:
            continue
        assert 0 <= telegram.ipoc < 2**32
        for values in telegram:
            if isinstance(values, np.ndarray):
                assert np.isfinite(values).all()


@given(
    st.lists(st.floats(-1.0, 1.0, allow_subnormal=False), min_size=9, max_size=9),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["krc2", "krc4"]),
)
def test_a_round_trip_is_accurate_to_half_a_decimal(values: list[float], ipoc: int, krc: str) -> None:
    axes = AxisMap.of(NINE, ("m",) * 3 + ("rad",) * 6, krc)  # type: ignore[arg-type]  # sampled from its literals
    q = np.array(values)
    at_krc, at_pc = KrcCodec(CANONICAL, axes), SensorCodec(CANONICAL, axes)
    seen = at_pc.decode(at_krc.encode(report(q)._replace(ipoc=ipoc)))
    assert seen.ipoc == ipoc
    assert seen.q is not None
    assert np.abs((seen.q - q) * axes.reported).max() <= 0.5e-4 + 1e-8
    heard = at_krc.decode(at_pc.encode(ipoc, q))
    assert heard.ipoc == ipoc
    assert np.abs((heard.correction - q) * axes.commanded).max() <= 0.5e-6 + 1e-9


def matrix_from_pose(x: float, y: float, z: float, a: float, b: float, c: float) -> Any:
    """(4, 4) transform of X, Y, Z [m] and A, B, C [rad], as pinocchio has KUKA's Rz Ry Rx."""
    return pin.SE3(pin.rpy.rpyToMatrix(c, b, a), np.array([x, y, z])).homogeneous


@given(st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3))
def test_a_pose_survives_conversion_to_the_angles_of_kuka(angles: list[float]) -> None:
    T = matrix_from_pose(0.1, 0.2, 0.3, *angles)
    assert matrix_from_pose(*pose_from_matrix(T)) == pytest.approx(T, abs=1e-9)


def test_a_pose_with_b_at_ninety_degrees_is_written_with_c_zero() -> None:
    T = matrix_from_pose(0.0, 0.0, 0.0, 0.4, math.pi / 2, 0.1)
    pose = pose_from_matrix(T)
    assert pose[3:] == pytest.approx((0.3, math.pi / 2, 0.0))
    assert matrix_from_pose(*pose) == pytest.approx(T, abs=1e-12)


WITH_STOP = ARM_CORRECTION + element("Do.O1", "BOOL", 7) + element("Stop", "BOOL", 8)


def test_stop_has_its_own_signal_and_is_off_by_default() -> None:
    config = make_config(CANONICAL_SEND, WITH_STOP)
    sensor = SensorCodec(config, ARM_AXES, outputs={"gripper": "Do.O1"}, stop="Stop")
    krc = KrcCodec(config, ARM_AXES, outputs={"gripper": "Do.O1", "stop": "Stop"})
    still = np.zeros(6)
    assert krc.decode(sensor.encode(1, still, {"gripper": True})).outputs == {"gripper": True, "stop": False}
    assert krc.decode(sensor.encode(1, still, stop=True)).outputs == {"gripper": False, "stop": True}


def test_a_user_output_can_neither_share_nor_set_the_stop_signal() -> None:
    config = make_config(CANONICAL_SEND, WITH_STOP)
    with pytest.raises(
        EthernetConfigError, match=r"Stop of RECEIVE is named for gripper and for driver\.stop"
    ):
        SensorCodec(config, ARM_AXES, outputs={"gripper": "Stop"}, stop="Stop")
    with pytest.raises(
        EthernetConfigError, match=r"no BOOL signal Halt, which the cell names for driver\.stop"
    ):
        SensorCodec(config, ARM_AXES, stop="Halt")
    with pytest.raises(TelegramError, match=r"driver\.stop"):
        SensorCodec(config, ARM_AXES, stop="Stop").encode(1, np.zeros(6), {"driver.stop": True})


EVERYTHING = make_config(
    CANONICAL_SEND, WITH_STOP + element("DEF_EStr", "STRING") + element("Other.X", "LONG", 9)
)
AT_PC = SensorCodec(EVERYTHING, ARM_AXES, outputs={"gripper": "Do.O1"}, stop="Stop")
AT_KRC = KrcCodec(EVERYTHING, ARM_AXES, outputs={"gripper": "Do.O1"}, stop="Stop")


def shown(telegram: SensorTelegram) -> list[object]:
    """All of a reply's fields, numbers to the last bit."""
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in telegram]


def decoded(decode: Callable[[bytes], SensorTelegram], datagram: bytes) -> list[object] | str:
    try:
        return shown(decode(datagram))
    except TelegramError as error:
        return str(error)


@given(
    st.lists(st.floats(-300.0, 300.0), min_size=6, max_size=6),
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.booleans(),
    st.text(st.characters(codec="ascii")),
)
def test_a_compact_reply_is_read_like_any_other(
    values: list[float], ipoc: int, gripper: bool, stop: bool, text: str
) -> None:
    reply = with_text(AT_PC.encode(ipoc, np.array(values), {"gripper": gripper}, stop=stop), text)
    assert decoded(AT_KRC.decode, reply) == decoded(AT_KRC._decode_any, reply)


@given(st.data())
def test_a_damaged_compact_reply_is_read_or_refused_like_any_other(data: st.DataObject) -> None:
    reply = AT_PC.encode(7, np.linspace(-1.0, 1.0, 6), {"gripper": True}, stop=True)
    damaged = bytearray(with_text(reply, "x y"))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(damaged) - 1))
        damaged[place] = data.draw(st.sampled_from(b"0123456789.+-eE \"'<>&/=\0\x01\tAnX\xff"))
    assert decoded(AT_KRC.decode, bytes(damaged)) == decoded(AT_KRC._decode_any, bytes(damaged))


@pytest.mark.parametrize("ending", [b"", b"\0", b"\0\0\0"])
def test_a_compact_reply_takes_the_fast_path(monkeypatch: pytest.MonkeyPatch, ending: bytes) -> None:
    reply = with_text(AT_PC.encode(7, np.zeros(6)), "x y") + ending
    monkeypatch.delattr(KrcCodec, "_decode_any")
    assert AT_KRC.decode(reply).text == "x y"
