"""The two ROS messages in CDR: byte for byte what another library makes, and nothing hostile is read."""

import math
import struct

import pytest
import ros_types
from hypothesis import given
from hypothesis import strategies as st

from deltaq_controllers.ros2.messages import (
    MAX_POINTS,
    Header,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    RefusedMessageError,
    RosTime,
)

times = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 10**9 - 1))
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
floats = st.lists(st.floats(allow_nan=False), max_size=7)
names = st.lists(texts, max_size=7)
points = st.lists(st.tuples(floats, floats, floats, floats, times), max_size=4)

# header of 2 s and 5 ns, no names, one point of one joint at 1.5 rad after 1 s; written down by hand from the rules
BY_HAND = bytes.fromhex(
    "00010000"
    "02000000" "05000000" "01000000" "00"  # stamp, an empty frame_id
    "000000" "00000000"  # padding, no names
    "01000000" "01000000"  # one point, one position: 28 bytes so far
    "00000000" "000000000000f83f"  # padding to a multiple of eight
    "00000000" "00000000" "00000000"  # nothing else: an empty sequence is not aligned
    "01000000" "00000000"
)  # fmt: skip


def trajectory(names, points, stamp=(0, 0), frame_id=""):
    made = tuple(JointTrajectoryPoint(*map(tuple, p[:4]), time_from_start=RosTime(*p[4])) for p in points)
    return JointTrajectory(Header(RosTime(*stamp), frame_id), tuple(names), made)


@pytest.mark.long
@given(times, texts, names, st.tuples(floats, floats, floats))
def test_a_joint_state_is_byte_for_byte_that_of_another_library(stamp, frame_id, names, values):
    ours = JointState(Header(RosTime(*stamp), frame_id), tuple(names), *map(tuple, values))
    theirs = ros_types.joint_state(stamp, frame_id, names, *values)
    assert ours.encode() == theirs
    assert JointState.decode(theirs) == ours


@pytest.mark.long
@given(times, texts, names, points)
def test_a_trajectory_is_byte_for_byte_that_of_another_library(stamp, frame_id, names, points):
    ours = trajectory(names, points, stamp, frame_id)
    theirs = ros_types.joint_trajectory(names, points, stamp, frame_id)
    assert ours.encode() == theirs
    assert JointTrajectory.decode(theirs) == ours


def test_both_are_what_the_rules_say_when_written_down_by_hand():
    assert trajectory((), [((1.5,), (), (), (), (1, 0))], (2, 5)).encode() == BY_HAND
    assert ros_types.joint_trajectory((), [((1.5,), (), (), (), (1, 0))], (2, 5)) == BY_HAND


@pytest.mark.parametrize("kind", [JointState, JointTrajectory])
def test_the_hash_of_a_type_is_what_another_library_computes(kind):
    assert ros_types.STORE.hash_rihs01(kind.TYPE.name) == kind.TYPE.hash


def test_the_hashes_are_those_that_a_running_ros_has_printed():
    # `ros2 topic info --verbose` of a running ROS 2, beside a joint_state_broadcaster and a joint_trajectory_controller
    state = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    command = "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
    assert (JointState.TYPE.hash, JointTrajectory.TYPE.hash) == (state, command)


def refusal(message):
    """Why it is refused, in words; empty if it is not."""
    try:
        JointTrajectory.decode(message)
    except RefusedMessageError as error:
        return str(error)
    return ""


@given(st.binary(max_size=200))
def test_bytes_of_anybody_are_a_message_or_are_refused(body):
    for start in (b"", b"\x00\x01\x00\x00"):
        assert "\n" not in refusal(start + body)


@pytest.mark.long
@given(points, st.data())
def test_a_message_that_is_cut_off_or_changed_is_a_message_or_is_refused(points, data):
    whole = bytearray(trajectory(("a1", "a2"), points).encode())
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(RefusedMessageError):
        JointTrajectory.decode(bytes(cut[:-4] if len(cut) > 4 else cut))
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    assert "\n" not in refusal(bytes(whole))


def hostile(offset, number):
    """The message by hand with another number of four bytes at an offset."""
    return BY_HAND[:offset] + struct.pack("<I", number) + BY_HAND[offset + 4 :]


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (b"", "encapsulation is missing, allowed is 00 01 00 00 (plain CDR, little-endian)"),
        (b"\x00\x00\x00\x00", "encapsulation is 00 00 00 00"),
        (b"\x00\x07\x00\x00" + BY_HAND[4:], "encapsulation is 00 07 00 00"),
        (BY_HAND[:9], "header.stamp.nanosec is cut off after 9 bytes, allowed is a whole field"),
        (hostile(8, 10**9), "header.stamp.nanosec is 1000000000, allowed is less than 1000000000"),
        (hostile(12, 2**32 - 1), "header.frame_id is of length 4294967295, allowed is 256 or less"),
        (hostile(12, 0), "header.frame_id is not ended by its only zero"),
        (BY_HAND[:16] + b"\xff" + BY_HAND[17:], "header.frame_id is not ended by its only zero"),
        (hostile(20, 2**31), "joint_names is of length 2147483648, allowed is 32 or less"),
        (hostile(24, MAX_POINTS + 1), f"points is of length {MAX_POINTS + 1}, allowed is {MAX_POINTS} or less"),
        (hostile(24, MAX_POINTS), "points is of length 1000, allowed is no more than the 36 bytes that follow hold"),
        (hostile(28, 33), "points[0].positions is of length 33, allowed is 32 or less"),
        (hostile(28, 30), "points[0].positions is of length 30, allowed is no more than the 32 bytes"),
        (BY_HAND + bytes(4), "message is 4 bytes too long"),
        (bytes(1024 * 1024 + 1), "message is 1048577 bytes long, allowed is 1048576 or less"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_what_is_hostile_is_refused_by_field_value_and_bound(message, text):
    with pytest.raises(RefusedMessageError) as refused:
        JointTrajectory.decode(message)
    assert str(refused.value).startswith(text)


def test_a_name_that_is_no_text_is_refused():
    message = JointTrajectory(joint_names=("ab",)).encode().replace(b"ab\0", b"\xff\xfe\0")
    with pytest.raises(RefusedMessageError, match=r"joint_names\[0\] is not in UTF-8"):
        JointTrajectory.decode(message)


def test_padding_to_a_multiple_of_four_is_no_error():
    message = JointState(name=("a",), position=(math.pi,)).encode()
    assert JointState.decode(message + bytes(3)) == JointState.decode(message)
