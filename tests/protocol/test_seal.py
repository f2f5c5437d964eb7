"""Seals: whoever lacks the key, or says something again, elsewhere or to somebody else, says nothing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol.seal import MAX_SEALED_BYTES, ForgedMessageError, Seal, UnboundMessageError
from deltaq_protocol.seal_keys import KEY_BYTES, RealmKey

KEY = bytes(range(KEY_BYTES))
WHERE = "deltaq-guarded/lab/fr/request"
BACK = "deltaq-guarded/lab/fr/admission"


def acquainted(key: bytes = KEY) -> tuple[Seal, Seal]:
    """A sender and a receiver that it knows."""
    sender, receiver = Seal(RealmKey(key)), Seal(RealmKey(key))
    sender.meet(BACK, receiver.close(BACK, b"greeting"))
    return sender, receiver


@given(st.lists(st.binary(max_size=300)), st.text())
def test_what_is_sealed_comes_out_as_it_went_in(messages, where):
    sender, receiver = acquainted()
    for message in messages:
        assert receiver.open(where, sender.close(where, message)) == message


@given(st.binary(max_size=100), st.data())
def test_whatever_bit_is_changed_the_message_is_refused_and_the_next_one_is_not(message, data):
    sender, receiver = acquainted()
    sealed = bytearray(sender.close(WHERE, message))
    bit = data.draw(st.integers(0, 8 * len(sealed) - 1))
    sealed[bit // 8] ^= 1 << bit % 8
    for take in (receiver.open, receiver.read, receiver.meet):
        with pytest.raises(ForgedMessageError, match="without the seal"):
            take(WHERE, bytes(sealed))
    assert receiver.open(WHERE, sender.close(WHERE, message)) == message


@given(st.binary(max_size=100))
def test_bytes_that_somebody_made_up_are_refused(payload):
    with pytest.raises(ForgedMessageError, match=f"{WHERE}: {len(payload)} bytes"):
        Seal(RealmKey(KEY)).open(WHERE, payload)


@given(st.data())
def test_a_part_of_a_message_is_refused(data):
    sender, receiver = acquainted()
    sealed = sender.close(WHERE, b"message")
    part = sealed[: data.draw(st.integers(0, len(sealed) - 1))]
    for take in (receiver.open, receiver.read):
        with pytest.raises(ForgedMessageError, match="without the seal"):
            take(WHERE, part)


def test_a_seal_of_another_key_is_refused():
    other, receiver = Seal(RealmKey(bytes(KEY_BYTES))), Seal(RealmKey(KEY))
    with pytest.raises(ForgedMessageError, match="without the seal of a holder of this realm's key"):
        receiver.open(WHERE, other.close(WHERE, b"x"))


@pytest.mark.parametrize(
    "elsewhere", ["deltaq-guarded/lab/gr/request", "deltaq-guarded/other/fr/request", WHERE + "s", WHERE[:-1]]
)
def test_a_message_says_nothing_under_another_key(elsewhere):
    sender, receiver = acquainted()
    with pytest.raises(ForgedMessageError):
        receiver.open(elsewhere, sender.close(WHERE, b"x"))


def test_no_byte_passes_from_the_key_into_the_message():
    sender, receiver = acquainted()
    sealed = sender.close("a/b", b"cd")
    with pytest.raises(ForgedMessageError):
        receiver.open("a/", sealed[:-2] + b"bcd")


def test_a_message_is_good_once_and_an_older_one_never_again():
    sender, receiver = acquainted()
    first, second = sender.close(WHERE, b"reset"), sender.close(WHERE, b"stop")
    assert receiver.open(WHERE, second) == b"stop"
    for replayed in (second, first):
        with pytest.raises(ForgedMessageError, match="again, the newest so far is 2"):
            receiver.open(WHERE, replayed)


def test_what_was_recorded_before_a_process_began_says_nothing_to_it_not_even_if_it_has_heard_nothing_else():
    sender, before = acquainted()
    recorded = [sender.close(WHERE, b"%d" % k) for k in range(10)]
    assert before.open(WHERE, recorded[-1]) == b"9"
    after = Seal(RealmKey(KEY))
    for message in recorded:
        with pytest.raises(UnboundMessageError, match=f"{WHERE}: not made for this process"):
            after.open(WHERE, message)


def test_a_process_that_begins_anew_is_known_after_one_greeting():
    sender, _ = acquainted()
    after = Seal(RealmKey(KEY))
    with pytest.raises(UnboundMessageError):
        after.open(WHERE, sender.close(WHERE, b"state"))
    sender.meet(BACK, after.close(BACK, b"greeting"))
    assert after.open(WHERE, sender.close(WHERE, b"state")) == b"state"


def test_both_ends_may_begin_anew_and_whoever_speaks_first_is_answered():
    one, other = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    with pytest.raises(UnboundMessageError):
        other.open(WHERE, one.close(WHERE, b"state"))
    one.meet(BACK, other.close(BACK, b"greeting"))
    assert other.open(WHERE, one.close(WHERE, b"state")) == b"state"
    assert one.open(BACK, other.close(BACK, b"supervision")) == b"supervision"


def successor(receiver: Seal) -> Seal:
    after = Seal(RealmKey(KEY))
    after.meet(BACK, receiver.close(BACK, b"greeting"))
    return after


def test_a_sender_that_starts_anew_is_heard_at_once_and_what_it_said_before_is_not():
    before, receiver = acquainted()
    said = [before.close(WHERE, b"%d" % k) for k in range(10)]
    receiver.open(WHERE, said[4])
    after = successor(receiver)
    assert receiver.open(WHERE, after.close(WHERE, b"again")) == b"again"
    for message in said:
        with pytest.raises(ForgedMessageError):
            receiver.open(WHERE, message)
    assert receiver.open(WHERE, after.close(WHERE, b"and again")) == b"and again"


def test_no_predecessor_is_forgotten_however_often_a_sender_starts_anew():
    sender, receiver = acquainted()
    first = [sender.close(WHERE, b"%d" % k) for k in range(2)]
    receiver.open(WHERE, first[0])
    for _ in range(100):
        receiver.open(WHERE, successor(receiver).close(WHERE, b"again"))
    with pytest.raises(ForgedMessageError, match="taken the place"):
        receiver.open(WHERE, first[1])


def test_what_a_long_gone_process_said_takes_nobody_s_place():
    gone, _ = acquainted()
    sender, receiver = acquainted()
    receiver.open(WHERE, sender.close(WHERE, b"one"))
    with pytest.raises(UnboundMessageError):
        receiver.open(WHERE, gone.close(WHERE, b"recorded"))
    assert receiver.open(WHERE, sender.close(WHERE, b"two")) == b"two"


def test_recordings_of_many_processes_keep_nobody_from_being_known():
    receiver, sender = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    for _ in range(100):
        receiver.meet(WHERE, Seal(RealmKey(KEY)).close(WHERE, b"recorded"))
    with pytest.raises(UnboundMessageError):
        receiver.open(WHERE, sender.close(WHERE, b"state"))
    greeting = receiver.close(BACK, b"greeting")
    assert sender.open(BACK, greeting) == b"greeting"
    assert len(greeting) < 200


def test_one_key_is_not_kept_waiting_for_the_numbers_of_another():
    sender, receiver = acquainted()
    early, late = sender.close("a", b"early"), sender.close("b", b"late")
    assert receiver.open("b", late) == b"late"
    assert receiver.open("a", early) == b"early"


def test_one_message_is_good_for_all_who_are_known():
    sender, receivers = Seal(RealmKey(KEY)), [Seal(RealmKey(KEY)) for _ in range(3)]
    for number, receiver in enumerate(receivers):
        sender.meet(f"greeting/{number}", receiver.close(f"greeting/{number}", b""))
    sealed = sender.close(WHERE, b"state")
    assert [receiver.open(WHERE, sealed) for receiver in receivers] == [b"state"] * 3


def test_who_only_watches_reads_what_was_made_for_others_and_takes_nothing_from_them():
    sender, receiver = acquainted()
    watcher, sealed = Seal(RealmKey(KEY)), sender.close(WHERE, b"state")
    assert [watcher.read(WHERE, sealed), receiver.read(WHERE, sealed)] == [b"state"] * 2
    assert receiver.open(WHERE, sealed) == b"state"


def test_strangers_cannot_fill_the_memory():
    receiver = Seal(RealmKey(KEY))
    for k in range(1000):
        with pytest.raises(ForgedMessageError):
            receiver.open(f"deltaq-guarded/lab/{k}/request", b"x" * 100)
    assert receiver._links == {}


def test_a_long_message_is_refused_whoever_sealed_it():
    sender, receiver = acquainted()
    longest = MAX_SEALED_BYTES - (len(sender.close(WHERE, b"")))
    assert receiver.open(WHERE, sender.close(WHERE, b"x" * longest))
    with pytest.raises(ForgedMessageError, match="16385 bytes, at most 16384 are sealed"):
        receiver.open(WHERE, sender.close(WHERE, b"x" * (longest + 1)))


def test_a_key_of_another_length_is_refused():
    with pytest.raises(ValueError, match="has 31 bytes; it must have 32"):
        Seal(RealmKey(KEY[:-1]))
