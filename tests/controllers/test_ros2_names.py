"""Keys, tokens and attachments beside the examples that rmw_zenoh's design document prints."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_controllers.ros2.messages import RefusedMessageError
from deltaq_controllers.ros2.rmw import (
    RosAttachment,
    RosNameError,
    RosNode,
    RosType,
    checked_domain_id,
    checked_namespace,
    ros_name,
    topic_key,
)

STRING = RosType(
    "std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
LISTENER = RosNode(2, "aac3178e146ba6f1fc6e6a4085e77f21", "/", "listener")
TYPE = f"std_msgs::msg::dds_::String_/{STRING.hash}"


def test_the_key_of_a_topic_is_that_of_the_design_document():
    assert topic_key(0, "/chatter", STRING) == f"0/chatter/{TYPE}"
    assert topic_key(0, "/robot1/chatter", STRING) == f"0/robot1/chatter/{TYPE}"


def test_tokens_are_those_of_the_design_document():
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
def test_what_is_no_attachment_is_refused(attachment, text):
    with pytest.raises(RefusedMessageError, match=text):
        RosAttachment.decode(attachment)


@pytest.mark.parametrize(
    "name", ["", "lab", "/lab/", "//", "/1lab", "/lab-4ms", "/lab/a__b", "/lab/*", "/a/%", "/é"]
)
def test_what_is_no_namespace_is_refused(name):
    with pytest.raises(RosNameError, match="no ROS namespace"):
        checked_namespace(name)


def test_names_of_cells_become_names_of_ros():
    assert ros_name("lab-4ms") == "lab_4ms"
    assert ros_name("a--b") == "a_b"
    for namespace in ("/", "/lab", "/plant/cell_2"):
        assert checked_namespace(namespace) == namespace


@pytest.mark.parametrize("domain_id", [-1, 233])
def test_a_domain_out_of_bounds_is_refused(domain_id):
    with pytest.raises(RosNameError, match=f"ROS domain {domain_id}: allowed are 0 to 232"):
        checked_domain_id(domain_id)
