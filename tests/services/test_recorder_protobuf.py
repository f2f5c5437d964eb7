import math

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from small_cell import server_state

from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import (
    Command,
    GateMemory,
    OrdersMemory,
    Request,
    RobotMemory,
    Supervision,
    TrackerMemory,
)
from deltaq_protocol.messages import (
    Message,
    NearestPair,
    Outcome,
    Phase,
    Proximity,
    Reason,
    RobotState,
    ToolPose,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.topics import TOPICS
from deltaq_services.recorder.protobuf import ProtobufSchema, SchemaError, recorded_schema, to_message

VERDICT = Verdict(
    robot="fr",
    cycle=7,
    seq=2**62,
    outcome=Outcome.HELD,
    scale=-0.0,
    dq=(0.1, -0.0, 5e-324, -999999.9999999999),
    reasons=(
        Reason(code=ReasonCode.CLEARANCE, what="a b", value=-0.0),
        Reason(code=ReasonCode.RETREAT, bound=0.0),
    ),
    clearance_m=0.0,
    pair=("fr/link_5", "gr/tool"),
    receipt="",
)
MEMORY = GateMemory(
    epoch=2**61,
    number=3,
    sequence=1,
    receipt="ab",
    fingerprint="c-d",
    robots={
        "gr": RobotMemory(
            tracker=TrackerMemory(state=server_state("gr"), history=((0.1,) * 9, (-0.0,) * 9)),
            orders=OrdersMemory(
                standing_stop=ReasonCode.KRC_LOST,
                cycles_without_hli=0,
                awaited_resets=(0, 5),
                outputs={"gripper": False},
            ),
            waiting=Request(robot="gr", cycle=4, lease_epoch=1, seq=0, dq=(0.0,) * 9),
            decided_cycle=-1,
            lease_epoch=0,
            seq=-1,
        ),
        "fr": RobotMemory(
            tracker=TrackerMemory(), orders=OrdersMemory(), decided_cycle=0, lease_epoch=0, seq=0
        ),
    },
)
MESSAGES = [
    VERDICT,
    Verdict(robot="fr", cycle=0, seq=0, outcome=Outcome.REFUSED),
    MEMORY,
    server_state("fr"),
    RobotState(
        robot="fr",
        cycle=1,
        ipoc=12,
        time_s=1.5,
        q=(0.1,) * 6,
        q_cmd=(0.2,) * 6,
        tool=ToolPose(position=(1.0, 2.0, 3.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)),
        phase=Phase.HELD,
        reason=ReasonCode.OPERATOR_STOP,
    ),
    Proximity(
        time_s=0.0,
        pairs=(NearestPair(pair=("a", "b"), distance_m=0.1, points_m=((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))),),
    ),
    Supervision(robot="fr", epoch=1, cycle=2, outputs={"gripper": True, "lamp": False}),
    Command(id=0, kind="stop"),
    Command(id=1, kind="io", robot="gr", outputs={"gripper": False}),
    Request(robot="fr", cycle=1, lease_epoch=0),
]


def bits(value: object) -> object:
    """A dumped message with every number as its exact digits, so that -0.0 and 0.0 differ."""
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, dict):
        return {key: bits(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [bits(item) for item in value]
    return value


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
def test_a_message_survives_protobuf_bit_for_bit(message: Message) -> None:
    encoded = recorded_schema().encode(message)
    back = to_message(type(message), type(encoded).FromString(encoded.SerializeToString()))
    assert bits(back.model_dump()) == bits(message.model_dump())
    assert math.copysign(1.0, VERDICT.scale) == -1.0  # or the comparison above would prove less than it says


def test_every_recorded_topic_has_a_fully_qualified_schema() -> None:
    for topic in TOPICS:
        if topic.recorded:
            descriptor = recorded_schema().classes[topic.message].DESCRIPTOR
            assert descriptor.full_name == f"deltaq.{topic.message.__name__}"
            assert set(descriptor.fields_by_name) == set(topic.message.model_fields)


def test_an_enumeration_keeps_its_names_and_begins_with_unspecified() -> None:
    encoded = recorded_schema().encode(VERDICT)
    values = encoded.DESCRIPTOR.fields_by_name["outcome"].enum_type.values_by_number
    assert values[0].name == "OUTCOME_UNSPECIFIED"
    assert values[encoded.outcome].name == "OUTCOME_HELD"


def other_version(fields: dict[str, int], enum: list[str]) -> type:
    """A Verdict as another version may have described it: other numbers, other fields."""
    file = descriptor_pb2.FileDescriptorProto(name="old.proto", package="deltaq", syntax="proto3")
    outcome = file.enum_type.add(name="Outcome")
    for number, name in enumerate(enum):
        outcome.value.add(name=name, number=number)
    message = file.message_type.add(name="Verdict")
    for number, (name, kind) in enumerate(fields.items(), start=1):
        field = message.field.add(name=name, number=number, type=kind, label=1)
        if kind == field.TYPE_ENUM:
            field.type_name = ".deltaq.Outcome"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("deltaq.Verdict"))


def test_a_recording_of_another_version_is_read_by_the_names_of_its_fields() -> None:
    field = descriptor_pb2.FieldDescriptorProto
    old = other_version(
        {
            "dropped_since": field.TYPE_DOUBLE,
            "outcome": field.TYPE_ENUM,
            "seq": field.TYPE_INT64,
            "cycle": field.TYPE_INT64,
            "robot": field.TYPE_STRING,
        },
        ["OUTCOME_UNSPECIFIED", "OUTCOME_REFUSED", "OUTCOME_ADMITTED"],
    )
    verdict = to_message(Verdict, old(robot="gr", cycle=3, seq=4, outcome=2, dropped_since=1.0))
    assert verdict == Verdict(robot="gr", cycle=3, seq=4, outcome=Outcome.ADMITTED)


def test_an_unknown_value_is_an_invalid_message() -> None:
    field = descriptor_pb2.FieldDescriptorProto
    fields = {
        "outcome": field.TYPE_ENUM,
        "robot": field.TYPE_STRING,
        "cycle": field.TYPE_INT64,
        "seq": field.TYPE_INT64,
    }
    other = other_version(fields, ["OUTCOME_UNSPECIFIED", "OUTCOME_DREAMT"])
    with pytest.raises(InvalidMessageError, match="OUTCOME_DREAMT"):
        to_message(Verdict, other(outcome=1, robot="fr", cycle=1, seq=1))


def test_a_field_without_counterpart_is_named() -> None:
    class Odd(Message):
        pairs: tuple[tuple[str, int], ...]

    with pytest.raises(SchemaError, match=r"Odd\.pairs"):
        ProtobufSchema([Odd])
