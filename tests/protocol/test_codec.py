"""What the codecs refuse, with which code, and that what they write is read back."""

import json
import math
import traceback
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_cell import server_state

from deltaq_protocol import messages
from deltaq_protocol.codec import (
    MAX_MESSAGE_BYTES,
    InvalidMessageError,
    from_map,
    kind_of,
    line_to_map,
    pack,
    place,
    quoted,
    shown,
    to_line,
    unpack,
)
from deltaq_protocol.guarded import Plan, ServerState
from deltaq_protocol.messages import (
    MOST,
    MOST_OF_A_JOINT,
    Challenge,
    Hello,
    Increment,
    LeaseReply,
    LeaseRequest,
    Message,
    Outcome,
    Phase,
    Reason,
    RobotState,
    ToolPose,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode

INCREMENT: dict[str, Any] = {"type": "increment", "robot": "fr", "seq": 1, "cycle": 2, "dq": [0.0] * 6}

FINITE = st.floats(-MOST, MOST)
JOINTS = st.lists(st.floats(-MOST_OF_A_JOINT, MOST_OF_A_JOINT), min_size=1, max_size=32).map(tuple)
COUNTS = st.integers(0, 2**63 - 1)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"dq": [math.nan] * 6}, ReasonCode.NOT_FINITE),
        ({"dq": [0.0, math.inf]}, ReasonCode.NOT_FINITE),
        ({"dq": [0.0, None]}, ReasonCode.NOT_FINITE),
        ({"dq": [0.0, 3e304]}, ReasonCode.NOT_FINITE),
        ({"dq": [-1e6 - 1e-9]}, ReasonCode.NOT_FINITE),
        ({"dq": []}, ReasonCode.BAD_SHAPE),
        ({"dq": [0.0] * 33}, ReasonCode.BAD_SHAPE),
        ({"dq": 0.0}, ReasonCode.BAD_SHAPE),
        ({"dq": None}, ReasonCode.BAD_SHAPE),
        ({"dq": ["fast"]}, ReasonCode.MALFORMED),
        ({"seq": -1}, ReasonCode.MALFORMED),
        ({"seq": 2**63}, ReasonCode.MALFORMED),
        ({"seq": 1.5}, ReasonCode.MALFORMED),
        ({"robot": "../gr"}, ReasonCode.MALFORMED),
        ({"robot": "*"}, ReasonCode.MALFORMED),
        ({"type": "stop"}, ReasonCode.MALFORMED),
        ({"speed": 1}, ReasonCode.MALFORMED),
    ],
)
def test_a_field_that_is_wrong_is_named_with_its_value_and_a_code(
    changes: dict[str, Any], code: ReasonCode
) -> None:
    with pytest.raises(InvalidMessageError) as caught:
        from_map(Increment, INCREMENT | changes)
    assert caught.value.code is code
    assert str(caught.value).startswith(next(iter(changes)))
    assert "got " in str(caught.value)
    assert caught.value.data["cycle"] == 2


def test_a_long_value_is_shown_shortened() -> None:
    with pytest.raises(InvalidMessageError) as caught:
        from_map(Increment, INCREMENT | {"robot": "r" * 10_000})
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    "line",
    [b"", b"{", b"[]", b"3", b"null", b"\xff\xfe\xff", b"[" * 100_000, b'{"a":' * 100_000, b"9" * 10_000],
)
def test_a_line_other_than_one_json_object_is_malformed(line: bytes) -> None:
    with pytest.raises(InvalidMessageError) as caught:
        line_to_map(line)
    assert caught.value.code is ReasonCode.MALFORMED


@pytest.mark.parametrize("payload", [b"", b"\xc1", msgpack.packb([1]), msgpack.packb({1: 2}), b"\x81" * 5000])
def test_bytes_other_than_a_msgpack_map_of_the_type_are_malformed(payload: bytes) -> None:
    with pytest.raises(InvalidMessageError) as caught:
        unpack(Increment, payload)
    assert caught.value.code is ReasonCode.MALFORMED


def test_an_oversized_message_is_not_decoded() -> None:
    with pytest.raises(InvalidMessageError, match=str(MAX_MESSAGE_BYTES)):
        unpack(Increment, b"\x00" * (MAX_MESSAGE_BYTES + 1))


@given(st.binary(max_size=200))
def test_arbitrary_bytes_raise_only_invalid_message(payload: bytes) -> None:
    for decode in (lambda: unpack(Increment, payload), lambda: from_map(Increment, line_to_map(payload))):
        try:
            decode()
        except InvalidMessageError as error:
            str(error).encode()


@pytest.mark.long
@given(JSON, st.dictionaries(st.sampled_from([*INCREMENT, "lease", "\ud800"]), JSON))
def test_arbitrary_maps_raise_only_invalid_message_with_a_sendable_text(
    data: Any, changes: dict[str, Any]
) -> None:
    for candidate in (data, INCREMENT | changes):
        try:
            from_map(Increment, candidate)
        except InvalidMessageError as error:
            str(error).encode()


@given(seq=COUNTS, cycle=COUNTS, dq=JOINTS)
def test_an_increment_is_read_back_bit_for_bit_from_both_codecs(
    seq: int, cycle: int, dq: tuple[float, ...]
) -> None:
    increment = Increment(robot="fr", seq=seq, cycle=cycle, dq=dq)
    assert unpack(Increment, pack(increment)) == increment
    assert from_map(Increment, line_to_map(to_line(increment))) == increment


@given(value=FINITE, scale=FINITE, code=st.sampled_from(ReasonCode), outcome=st.sampled_from(Outcome))
def test_a_verdict_is_read_back_with_its_reasons(
    value: float, scale: float, code: ReasonCode, outcome: Outcome
) -> None:
    reason = Reason(code=code, what="a1", value=value, bound=None)
    verdict = Verdict(
        robot="fr",
        cycle=1,
        seq=2,
        outcome=outcome,
        scale=scale,
        reasons=(reason,),
        pair=("fr/link_5", "gr/tool"),
    )
    assert unpack(Verdict, pack(verdict)) == verdict
    assert from_map(Verdict, line_to_map(to_line(verdict))) == verdict


def test_a_line_is_one_line_of_json_with_names_for_enumerations_and_ends_with_a_newline() -> None:
    state = RobotState(
        robot="fr",
        cycle=1,
        ipoc=12,
        time_s=0.5,
        q=(0.0,),
        q_cmd=(0.0,),
        tool=ToolPose(position=(1.0, 2.0, 3.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)),
        phase=Phase.HELD,
        reason=ReasonCode.KRC_LOST,
    )
    line = to_line(state)
    assert line.endswith(b"}\n")
    assert line.count(b"\n") == 1
    data = json.loads(line)
    assert (data["type"], data["phase"], data["reason"]) == ("state", "held", "krc_lost")


SECRET = "5ecre7-0123456789abcdef"
WITH_A_SECRET = {
    kind: [name for name, field in kind.model_fields.items() if not field.repr]
    for kind in vars(messages).values()
    if isinstance(kind, type)
    and issubclass(kind, Message)
    and any(not field.repr for field in kind.model_fields.values())
}


def refusal_of(kind: type[Message], data: object) -> str:
    """The words of the refusal, and of what a log shows of where it came from."""
    with pytest.raises(InvalidMessageError) as caught:
        from_map(kind, data)
    return str(caught.value) + "".join(traceback.format_exception(caught.value))


def test_every_token_field_is_marked_secret() -> None:
    named = {name for names in WITH_A_SECRET.values() for name in names}
    assert named == {"lease", "token", "challenge", "proof"}
    for kind, names in WITH_A_SECRET.items():
        assert named.intersection(kind.model_fields) == set(names), kind


@pytest.mark.parametrize("kind", WITH_A_SECRET, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("wrong", [[SECRET], {"a": SECRET}, {SECRET: 1}, SECRET.encode() + b"\xff"], ids=repr)
def test_a_secret_of_the_wrong_type_is_reported_by_its_type_alone(kind: type[Message], wrong: object) -> None:
    for name in WITH_A_SECRET[kind]:
        told = refusal_of(kind, {"type": "no such", name: wrong})
        assert SECRET not in told


@pytest.mark.parametrize("kind", WITH_A_SECRET, ids=lambda kind: kind.__name__)
def test_an_error_in_another_field_does_not_quote_the_secret(kind: type[Message]) -> None:
    for name in WITH_A_SECRET[kind]:
        for data in (
            {name: SECRET},
            {name: SECRET, "else": 1},
            {"tokn": SECRET},
            [{name: SECRET}],
            SECRET.encode(),
        ):
            if kind is Challenge and data == {name: SECRET}:
                data = {name: SECRET + "."}
            assert SECRET not in refusal_of(kind, data)


def test_errors_beside_a_secret_name_the_wrong_field_and_the_allowed_values() -> None:
    hello = {"type": "hello", "token": SECRET}
    assert refusal_of(Hello, hello).startswith("protocol: Field required")
    assert refusal_of(Hello, hello | {"protocol": "a"}).startswith(
        "protocol: Input should be a valid integer, unable to parse string as an integer, got 'a'"
    )
    said = refusal_of(Hello, {"type": "hello", "protocol": 1, "client": "me", "token": 5})
    assert said.startswith("token: Input should be a valid string, got a number")
    said = refusal_of(Hello, {"type": "hello", "protocol": 1, "client": "me", "tokn": SECRET})
    assert said.startswith("tokn: Extra inputs are not permitted, got a text of 23 characters")


def test_a_message_does_not_show_its_secret() -> None:
    shown = (
        repr(LeaseReply(robot="fr", granted=True, lease=SECRET)),
        repr(Hello(protocol=1, client="me", token=SECRET)),
    )
    assert SECRET not in "".join(shown)
    assert "holder" in shown[0]
    asked: LeaseRequest = LeaseRequest.model_validate({"robot": "fr", "action": "take", "token": SECRET})
    assert (SECRET in str(asked), asked.token) == (False, SECRET)


AROUND_A_SECRET = st.recursive(
    st.sampled_from([SECRET, 1, 0.5, None, True, "fr"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["robot", "lease", "dq"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@pytest.mark.long
@given(lease=AROUND_A_SECRET, extra=AROUND_A_SECRET, missing=st.sampled_from(["seq", "cycle", "dq"]))
def test_an_incomplete_increment_does_not_show_its_lease(lease: Any, extra: Any, missing: str) -> None:
    data = {"type": "increment", "robot": "fr", "seq": 1, "cycle": 2, "dq": [0.0] * 6, "lease": lease}
    del data[missing]
    assert SECRET not in refusal_of(Increment, data)
    assert SECRET not in refusal_of(Increment, data | {"leese": extra})


def test_unknown_names_and_values_are_shortened() -> None:
    assert len(place(("x" * 1000, "y" * 1000))) < 140
    assert len(shown("x" * 1000)) == len(shown([1.0] * 1000)) == 80
    assert quoted("fr", "robot", Increment) == "'fr'"
    assert quoted([1, None, True], "dq", Increment) == "[1, None, True]"
    assert [kind_of(value) for value in (None, True, 1, 0.5, "ab", b"ab", [1], {"a": 1}, object())] == [
        "null",
        "true or false",
        "a number",
        "a number",
        "a text of 2 characters",
        "2 bytes",
        "a list of 1",
        "a map of 1 fields",
        "a object",
    ]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"q_cmd": (0.0,)}, "q_cmd has 1 joints, q has 6"),
        ({"dq": (0.0,) * 7}, "dq has 7 joints, q has 6"),
        ({"plan": Plan(dq=(0.0,) * 9, brake_cycles=1, step=0)}, "plan.dq has 9 joints, q has 6"),
    ],
)
def test_a_state_with_inconsistent_joint_counts_is_invalid(changes, told):
    state = server_state()
    assert unpack(ServerState, pack(state)) == state
    with pytest.raises(InvalidMessageError, match=told):
        unpack(ServerState, pack(state.model_copy(update=changes)))
