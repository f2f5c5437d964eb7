"""What the codecs refuse, with which code, and that what they write is read back."""

from __future__ import annotations

import json
import math
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol.codec import (
    MAX_MESSAGE_BYTES,
    InvalidMessageError,
    from_map,
    line_to_map,
    pack,
    to_line,
    unpack,
)
from deltaq_protocol.messages import (
    MOST,
    MOST_OF_A_JOINT,
    Increment,
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
def test_a_line_that_is_not_one_json_object_is_malformed(line: bytes) -> None:
    with pytest.raises(InvalidMessageError) as caught:
        line_to_map(line)
    assert caught.value.code is ReasonCode.MALFORMED


@pytest.mark.parametrize("payload", [b"", b"\xc1", msgpack.packb([1]), msgpack.packb({1: 2}), b"\x81" * 5000])
def test_bytes_that_are_no_msgpack_map_of_the_type_are_malformed(payload: bytes) -> None:
    with pytest.raises(InvalidMessageError) as caught:
        unpack(Increment, payload)
    assert caught.value.code is ReasonCode.MALFORMED


def test_a_message_beyond_the_bound_is_not_even_decoded() -> None:
    with pytest.raises(InvalidMessageError, match=str(MAX_MESSAGE_BYTES)):
        unpack(Increment, b"\x00" * (MAX_MESSAGE_BYTES + 1))


@given(st.binary(max_size=200))
def test_no_bytes_whatever_raise_anything_but_invalid_message(payload: bytes) -> None:
    for decode in (lambda: unpack(Increment, payload), lambda: from_map(Increment, line_to_map(payload))):
        try:
            decode()
        except InvalidMessageError as error:
            str(error).encode()


@pytest.mark.long
@given(JSON, st.dictionaries(st.sampled_from([*INCREMENT, "lease", "\ud800"]), JSON))
def test_no_map_whatever_raises_anything_but_invalid_message_and_its_text_can_be_sent(
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
