"""Seals: whoever lacks the key, or says something again or elsewhere, says nothing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol.seal import KEY_BYTES, UNSEALED, ForgedMessageError, KeyedSeal

KEY = bytes(range(KEY_BYTES))
WHERE = "deltaq-guarded/lab/fr/request"


def seal(key: bytes = KEY, now_ns: int = 1000) -> KeyedSeal:
    return KeyedSeal(key, lambda: now_ns)


@given(st.lists(st.binary(max_size=300)), st.text())
def test_what_is_sealed_comes_out_as_it_went_in(messages, where):
    sender, receiver = seal(), seal()
    for message in messages:
        assert receiver.open(where, sender.close(where, message)) == message


@given(st.binary(max_size=100), st.data())
def test_whatever_bit_is_changed_the_message_is_refused_and_the_next_one_is_not(message, data):
    sender, receiver = seal(), seal()
    sealed = bytearray(sender.close(WHERE, message))
    bit = data.draw(st.integers(0, 8 * len(sealed) - 1))
    sealed[bit // 8] ^= 1 << bit % 8
    with pytest.raises(ForgedMessageError, match="without the seal"):
        receiver.open(WHERE, bytes(sealed))
    assert receiver.open(WHERE, sender.close(WHERE, message)) == message


@given(st.binary(max_size=100))
def test_bytes_that_somebody_made_up_are_refused(payload):
    with pytest.raises(ForgedMessageError, match=f"{WHERE}: {len(payload)} bytes"):
        seal().open(WHERE, payload)


def test_a_seal_of_another_key_is_refused():
    other = seal(bytes(KEY_BYTES))
    with pytest.raises(ForgedMessageError, match="without the seal of this realm's key"):
        seal().open(WHERE, other.close(WHERE, b"x"))


@pytest.mark.parametrize(
    "elsewhere", ["deltaq-guarded/lab/gr/request", "deltaq-guarded/other/fr/request", WHERE + "s", WHERE[:-1]]
)
def test_a_message_says_nothing_under_another_key(elsewhere):
    with pytest.raises(ForgedMessageError):
        seal().open(elsewhere, seal().close(WHERE, b"x"))


def test_no_byte_passes_from_the_key_into_the_message():
    sender = seal()
    sealed = sender.close("a/b", b"cd")
    moved = sealed[:40] + b"bcd"
    with pytest.raises(ForgedMessageError):
        seal().open("a/", moved)


def test_a_message_is_good_once_and_an_older_one_never_again():
    sender, receiver = seal(), seal()
    first, second = sender.close(WHERE, b"reset"), sender.close(WHERE, b"stop")
    assert receiver.open(WHERE, second) == b"stop"
    for replayed in (second, first):
        with pytest.raises(ForgedMessageError, match="again, the newest so far is 1002"):
            receiver.open(WHERE, replayed)


def test_a_sender_that_starts_anew_is_heard_at_once_and_what_it_said_before_is_not():
    before, receiver = seal(now_ns=1000), seal()
    said = [before.close(WHERE, b"%d" % k) for k in range(10)]
    receiver.open(WHERE, said[-1])
    after = seal(now_ns=2000)
    assert receiver.open(WHERE, after.close(WHERE, b"again")) == b"again"
    with pytest.raises(ForgedMessageError):
        receiver.open(WHERE, said[-1])


def test_one_key_is_not_kept_waiting_for_the_numbers_of_another():
    sender, receiver = seal(), seal()
    early, late = sender.close("a", b"early"), sender.close("b", b"late")
    assert receiver.open("b", late) == b"late"
    assert receiver.open("a", early) == b"early"


def test_strangers_cannot_fill_the_memory():
    receiver = seal()
    for k in range(1000):
        with pytest.raises(ForgedMessageError):
            receiver.open(f"deltaq-guarded/lab/{k}/request", b"x" * 100)
    assert receiver._newest == {}


def test_a_key_of_another_length_is_refused():
    with pytest.raises(ValueError, match="has 31 bytes; it must have 32"):
        KeyedSeal(KEY[:-1])


def test_without_a_key_messages_are_left_as_they_are():
    assert UNSEALED.open(WHERE, UNSEALED.close(WHERE, b"x")) == b"x"
