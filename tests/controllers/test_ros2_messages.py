"""The ROS messages that come and go; what is hostile is refused. Names of ROS."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_types import STORE, encoded, point, trajectory
from small_cell import small_cell
from told import told_state

from deltaq_cell.cell_model import robot_summary
from deltaq_controllers.ros2.messages import (
    JOINT_STATE,
    JOINT_TRAJECTORY,
    MAX_POINTS,
    JointStates,
    RefusedMessageError,
    decoded_trajectory,
)
from deltaq_controllers.ros2.rmw import (
    RosAttachment,
    RosNode,
    RosType,
    checked_domain_id,
    checked_namespace,
    ros_name,
    topic_key,
)
from deltaq_protocol.errors import DeltaqError

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


def test_a_hand_written_trajectory_is_read_by_the_cdr_rules():
    for padding in (b"", bytes(3)):  # some senders fill up to a multiple of four
        asked = decoded_trajectory(BY_HAND + padding)
        (only,) = asked.points
        assert (asked.header.stamp.sec, asked.header.stamp.nanosec, asked.joint_names) == (2, 5, [])
        assert (only.positions.tolist(), only.time_from_start.sec) == ([1.5], 1)


def test_a_joint_state_has_velocities_by_difference_if_the_state_before_is_near():
    robot = robot_summary(small_cell().robots["fr"], 0.004)
    states = JointStates(robot, 0.004)
    for cycle, q, expected in ((1, 0.1, []), (3, 0.3, [25.0] * 6), (14, 0.4, [])):
        state = told_state(cycle, 0.0).model_copy(update={"q": (q,) * 6})
        message = states.message(state, 7 * 10**9 + 5)
        told = STORE.deserialize_cdr(message, JOINT_STATE.name)
        assert (told.header.stamp.sec, told.header.stamp.nanosec, told.name) == (7, 5, list(robot.joints))
        assert (told.position.tolist(), told.effort.tolist()) == ([q] * 6, [])
        np.testing.assert_allclose(told.velocity, expected)


def test_type_hashes_agree_with_those_printed_by_ros():
    # `ros2 topic info --verbose` of a running ROS 2, beside a joint_state_broadcaster and a joint_trajectory_controller
    state = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    command = "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
    assert (JOINT_STATE.hash, JOINT_TRAJECTORY.hash) == (state, command)


def refusal(message):
    """Why it is refused, in words; empty if it is not."""
    try:
        decoded_trajectory(message)
    except RefusedMessageError as error:
        return str(error)
    return ""


@given(st.binary(max_size=200))
def test_arbitrary_bytes_are_decoded_or_refused(body):
    for start in (b"", b"\x00\x01\x00\x00"):
        assert "\n" not in refusal(start + body)


floats = st.lists(st.floats(allow_nan=False), max_size=7)
points = st.lists(st.builds(point, st.floats(0, 2**30), floats, floats, floats, floats), max_size=4)


@pytest.mark.long
@given(points, st.data())
def test_truncated_and_altered_messages_are_decoded_or_refused(points, data):
    whole = bytearray(encoded(trajectory(("a1", "a2"), *points)))
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(RefusedMessageError):
        decoded_trajectory(bytes(cut[:-4] if len(cut) > 4 else cut))
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    assert "\n" not in refusal(bytes(whole))


def hostile(offset, number):
    """The message by hand with another number of four bytes at an offset."""
    return BY_HAND[:offset] + struct.pack("<I", number) + BY_HAND[offset + 4 :]


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (b"", "message is malformed (Invalid or unsupported CDR encapsulation.)"),
        (b"\x00\x07\x00\x00" + BY_HAND[4:], "message is malformed (Invalid or unsupported CDR"),
        (BY_HAND[:9], "message is malformed (Could not deserialize"),
        (hostile(12, 2**32 - 1), "message is malformed (Invalid string length 4294967295"),
        (hostile(12, 0), "message is malformed (Invalid string length 0"),
        (BY_HAND[:16] + b"\xff" + BY_HAND[17:], "message is malformed (Missing string terminator"),
        (hostile(20, 2**31), "message is malformed (Invalid sequence length 2147483648"),
        (hostile(28, 30), "message is malformed (Invalid sequence length 30"),
        (BY_HAND + bytes(4), "message is malformed (CDR message size mismatch"),
        (encoded(trajectory(("ab",))).replace(b"ab\0", b"\xff\xfe\0"), "message is malformed (Could not deserialize"),
        (bytes(1024 * 1024 + 1), "message is 1048577 bytes long, allowed is 1048576 or less"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_hostile_input_is_refused_in_words(message, text):
    assert refusal(message).startswith(text)


def test_a_trajectory_of_too_many_points_is_refused_with_the_bound():
    most = [point(k, ()) for k in range(MAX_POINTS)]
    assert not refusal(encoded(trajectory((), *most)))
    assert refusal(encoded(trajectory((), *most, most[0]))).endswith(f"of {MAX_POINTS} points or less")


# Keys, tokens and attachments beside the examples that rmw_zenoh's design document prints.


STRING = RosType(
    "std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
LISTENER = RosNode(2, "aac3178e146ba6f1fc6e6a4085e77f21", "/", "listener")
TYPE = f"std_msgs::msg::dds_::String_/{STRING.hash}"


def test_the_key_of_a_topic_agrees_with_the_design_document():
    assert topic_key(0, "/chatter", STRING) == f"0/chatter/{TYPE}"
    assert topic_key(0, "/robot1/chatter", STRING) == f"0/robot1/chatter/{TYPE}"


def test_tokens_agree_with_the_design_document():
    begin = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0"
    assert LISTENER.token == f"{begin}/0/NN/%/%/listener"
    subscription = LISTENER.subscription(10, "/chatter", STRING, 10)
    assert subscription.token == f"{begin}/10/MS/%/%/listener/%chatter/{TYPE}/::,10:,:,:,,"
    publisher = LISTENER.publisher(10, "/chatter", STRING, 7)
    assert publisher.token == f"{begin}/10/MP/%/%/listener/%chatter/{TYPE}/::,7:,:,:,,"
    assert publisher.key == f"2/chatter/{TYPE}"


def test_a_namespace_and_the_slashes_of_a_topic_are_mangled():
    node = RosNode(0, "1", "/plant/lab", "deltaq")
    assert node.token == "@ros2_lv/0/1/0/0/NN/%/%plant%lab/deltaq"
    assert "/%plant%lab%fr%joint_states/" in node.publisher(1, "/plant/lab/fr/joint_states", STRING, 1).token


def test_two_endpoints_have_two_gids_of_16_bytes_and_one_has_always_the_same():
    first, second = (LISTENER.publisher(number, "/chatter", STRING, 1) for number in (1, 2))
    assert len(first.gid) == 16
    assert first.gid != second.gid
    assert first.gid == LISTENER.publisher(1, "/chatter", STRING, 1).gid


@given(
    st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(min_size=16, max_size=16)
)
def test_an_attachment_is_two_numbers_a_length_and_a_gid(sequence, time_ns, gid):
    encoded = struct.pack("<q", sequence) + struct.pack("<q", time_ns) + b"\x10" + gid
    assert RosAttachment(sequence, time_ns, gid).encode() == encoded
    assert RosAttachment.decode(encoded) == RosAttachment(sequence, time_ns, gid)


@pytest.mark.parametrize(
    ("attachment", "text"),
    [
        (None, "attachment is missing, allowed is 33 bytes"),
        (bytes(32), "attachment is 32 bytes long, allowed is 33 bytes"),
        (bytes(33), "attachment.gid is of length 0, allowed is 16"),
    ],
)
def test_an_invalid_attachment_is_refused(attachment, text):
    with pytest.raises(RefusedMessageError, match=text):
        RosAttachment.decode(attachment)


@pytest.mark.parametrize(
    "name", ["", "lab", "/lab/", "//", "/1lab", "/lab-4ms", "/lab/a__b", "/lab/*", "/a/%", "/é"]
)
def test_an_invalid_namespace_is_refused(name):
    with pytest.raises(DeltaqError, match="no ROS namespace"):
        checked_namespace(name)


def test_names_of_cells_become_names_of_ros():
    assert ros_name("lab-4ms") == "lab_4ms"
    assert ros_name("a--b") == "a_b"
    for namespace in ("/", "/lab", "/plant/cell_2"):
        assert checked_namespace(namespace) == namespace


@pytest.mark.parametrize("domain_id", [-1, 233])
def test_a_domain_out_of_bounds_is_refused(domain_id):
    with pytest.raises(DeltaqError, match=f"ROS domain {domain_id}: allowed are 0 to 232"):
        checked_domain_id(domain_id)
