"""No error quotes a token, a lease's secret or a proof, whatever is wrong with the message that it is in."""

from __future__ import annotations

import traceback
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol import messages
from deltaq_protocol.codec import InvalidMessageError, from_map, kind_of, place, quoted, shown
from deltaq_protocol.messages import Challenge, Hello, Increment, LeaseReply, LeaseRequest, Message

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


def test_every_field_for_a_token_is_known_as_a_secret() -> None:
    named = {name for names in WITH_A_SECRET.values() for name in names}
    assert named == {"lease", "token", "challenge", "proof"}
    for kind, names in WITH_A_SECRET.items():
        assert named.intersection(kind.model_fields) == set(names), kind


@pytest.mark.parametrize("kind", WITH_A_SECRET, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("wrong", [[SECRET], {"a": SECRET}, {SECRET: 1}, SECRET.encode() + b"\xff"], ids=repr)
def test_a_secret_of_another_type_is_told_by_its_kind(kind: type[Message], wrong: object) -> None:
    for name in WITH_A_SECRET[kind]:
        told = refusal_of(kind, {"type": "no such", name: wrong})
        assert SECRET not in told


@pytest.mark.parametrize("kind", WITH_A_SECRET, ids=lambda kind: kind.__name__)
def test_a_message_in_which_something_else_is_missing_or_too_much_is_not_quoted(kind: type[Message]) -> None:
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


def test_the_words_still_say_which_field_is_wrong_and_what_is_allowed() -> None:
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


JSON = st.recursive(
    st.sampled_from([SECRET, 1, 0.5, None, True, "fr"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["robot", "lease", "dq"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@pytest.mark.long
@given(lease=JSON, extra=JSON, missing=st.sampled_from(["seq", "cycle", "dq"]))
def test_no_increment_that_lacks_something_has_its_lease_quoted(lease: Any, extra: Any, missing: str) -> None:
    data = {"type": "increment", "robot": "fr", "seq": 1, "cycle": 2, "dq": [0.0] * 6, "lease": lease}
    del data[missing]
    assert SECRET not in refusal_of(Increment, data)
    assert SECRET not in refusal_of(Increment, data | {"leese": extra})


def test_names_and_values_that_strangers_made_up_are_shortened() -> None:
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
