"""Seals: whoever lacks the key, or says something again, elsewhere or to somebody else, says nothing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltaq_protocol.seal import MAX_SEALED_BYTES, ForgedMessageError, Seal, UnboundMessageError
from deltaq_protocol.seal_keys import KEY_BYTES, RealmKey

KEY = bytes(range(KEY_BYTES))
WHERE = "deltaq-guarded/lab/fr/request"
BACK = "deltaq-guarded/lab/fr/admission"
HELLO = "deltaq-guarded/lab/greeting/hli"


def acquainted(receiver: Seal | None = None) -> tuple[Seal, Seal]:
    """A sender that has just begun and a receiver that it knows."""
    sender, receiver = Seal(RealmKey(KEY)), receiver or Seal(RealmKey(KEY))
    receiver.meet(HELLO, sender.close(HELLO, b"greeting"))
    assert sender.meet(BACK, receiver.greet(BACK, b"greeting"))
    return sender, receiver


def recordings(where: str, processes: int) -> list[bytes]:
    """One message of each of so many processes that are gone."""
    return [Seal(RealmKey(KEY)).close(where, b"recorded") for _ in range(processes)]


def hear_in_vain(receiver: Seal, where: str, *said: bytes) -> None:
    for sealed in said:
        with pytest.raises(UnboundMessageError):
            receiver.open(where, sealed)


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
        with pytest.raises(ForgedMessageError, match="again, the newest so far is 3"):
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
    assert sender.meet(BACK, after.greet(BACK, b"greeting"))
    assert after.open(WHERE, sender.close(WHERE, b"state")) == b"state"


def test_both_ends_may_begin_anew_and_whoever_speaks_first_is_answered():
    one, other = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    with pytest.raises(UnboundMessageError):
        other.open(WHERE, one.close(WHERE, b"state"))
    assert one.meet(BACK, other.greet(BACK, b"greeting"))
    assert other.open(WHERE, one.close(WHERE, b"state")) == b"state"
    assert one.open(BACK, other.close(BACK, b"supervision")) == b"supervision"


def test_a_sender_that_starts_anew_is_heard_at_once_and_what_it_said_before_is_not():
    before, receiver = acquainted()
    said = [before.close(WHERE, b"%d" % k) for k in range(10)]
    receiver.open(WHERE, said[4])
    after, _ = acquainted(receiver)
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
        after, _ = acquainted(receiver)
        receiver.open(WHERE, after.close(WHERE, b"again"))
    with pytest.raises(ForgedMessageError, match="taken the place"):
        receiver.open(WHERE, first[1])


def test_what_a_long_gone_process_said_takes_nobody_s_place():
    gone, _ = acquainted()
    sender, receiver = acquainted()
    receiver.open(WHERE, sender.close(WHERE, b"one"))
    with pytest.raises(UnboundMessageError):
        receiver.open(WHERE, gone.close(WHERE, b"recorded"))
    assert receiver.open(WHERE, sender.close(WHERE, b"two")) == b"two"


# --- recordings of many processes, which come while one has just begun ---------------------------------


@pytest.mark.parametrize("order", ["before it", "after it"])
def test_as_many_recordings_as_a_greeting_names_keep_no_newcomer_from_being_greeted(order):
    receiver, newcomer = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    old = recordings(WHERE, 31)
    said = newcomer.close(WHERE, b"state")
    hear_in_vain(receiver, WHERE, *([*old, said] if order == "before it" else [said, *old, *old]))
    assert newcomer.open(BACK, receiver.greet(BACK, b"greeting")) == b"greeting"
    assert receiver.open(WHERE, newcomer.close(WHERE, b"state")) == b"state"
    assert receiver.passed_over == 0


@pytest.mark.parametrize("times", [1, 3])
def test_more_recordings_and_oftener_leave_a_newcomer_its_chance_with_each_greeting(times):
    receiver, newcomer = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    old = recordings(WHERE, 319)
    for _ in range(400):  # one of ten greetings names it: that none of so many does has a chance of 1e-18
        hear_in_vain(receiver, WHERE, newcomer.close(WHERE, b"state"), *old * times)
        greeting = receiver.greet(BACK, b"greeting")
        assert len(greeting) < 400, "and it has a bound"
        if newcomer.meet(BACK, greeting):
            break
    else:
        pytest.fail("it was never named")
    assert receiver.open(WHERE, newcomer.close(WHERE, b"state")) == b"state"
    assert receiver.passed_over >= 319 + 1 - 32


def test_recordings_take_nothing_from_those_who_have_shown_that_they_know_the_process():
    known = [f"deltaq-guarded/lab/{k}/state" for k in range(10)]
    senders = {where: acquainted() for where in known}
    receiver = Seal(RealmKey(KEY))
    for where in known:
        hear_in_vain(receiver, where, senders[where][0].close(where, b"state"))
    greeting = receiver.greet(BACK, b"greeting")
    for where, (sender, _) in senders.items():
        assert sender.meet(BACK, greeting)
        assert receiver.open(where, sender.close(where, b"state")) == b"state"
    for k in range(40):
        other = f"deltaq-guarded/lab/{k}/request"
        hear_in_vain(receiver, other, *recordings(other, 32))
    for said in (receiver.close(BACK, b"order"), receiver.greet(BACK, b"order")):
        assert [sender.open(BACK, said) for sender, _ in senders.values()] == [b"order"] * len(known)


def test_recordings_under_many_keys_leave_a_newcomer_under_another_its_place():
    receiver, newcomer = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    for k in range(40):
        other = f"deltaq-guarded/lab/{k}/request"
        hear_in_vain(receiver, other, *recordings(other, 32))
    hear_in_vain(receiver, WHERE, newcomer.close(WHERE, b"state"))
    greeting = receiver.greet(BACK, b"greeting")
    assert newcomer.open(BACK, greeting) == b"greeting"
    assert len(greeting) < 32 + 17 + 255 * 8 + 10


def test_who_has_shown_nothing_is_named_in_a_greeting_alone():
    receiver, newcomer = Seal(RealmKey(KEY)), Seal(RealmKey(KEY))
    before = len(receiver.close(BACK, b"order"))
    hear_in_vain(receiver, WHERE, newcomer.close(WHERE, b"state"), *recordings(WHERE, 100))
    assert len(receiver.close(BACK, b"order")) == before
    receiver.greet(BACK, b"greeting")
    assert len(receiver.greet(BACK, b"order")) == before, "and in one"


@pytest.mark.parametrize("successor_spoke", [True, False])
def test_what_was_kept_back_until_its_sender_was_gone_is_not_heard_under_any_key(successor_spoke):
    """The attack: a flood keeps a message from its receiver; it is said when its sender has a successor."""
    receiver = Seal(RealmKey(KEY))
    before, _ = acquainted(receiver)
    receiver.open(WHERE, before.close(WHERE, b"heard"))
    kept_back = before.close("command", b"reset")
    after, _ = acquainted(receiver)
    receiver.open(WHERE, after.close(WHERE, b"heard"))
    if successor_spoke:
        receiver.open("command", after.close("command", b"stop"))
    with pytest.raises(ForgedMessageError, match="taken the place of"):
        receiver.open("command", kept_back)
    assert receiver.open("command", after.close("command", b"stop")) == b"stop"


def test_who_greets_in_a_speaker_s_place_silences_nobody():
    """The attack: whoever has a listener's identity can greet that listener as anybody whom it listens to."""
    receiver = Seal(RealmKey(KEY))
    sender, _ = acquainted(receiver)
    impostor, _ = acquainted(receiver)
    assert receiver.meet(BACK + "/greeting", sender.greet(BACK + "/greeting", b""))
    receiver.open(WHERE, sender.close(WHERE, b"heard"))
    assert receiver.meet(BACK + "/greeting", impostor.greet(BACK + "/greeting", b""))
    assert receiver.open(WHERE, sender.close(WHERE, b"heard again")) == b"heard again"


def test_one_key_is_not_kept_waiting_for_the_numbers_of_another():
    sender, receiver = acquainted()
    early, late = sender.close("a", b"early"), sender.close("b", b"late")
    assert receiver.open("b", late) == b"late"
    assert receiver.open("a", early) == b"early"


def test_one_message_is_good_for_all_who_are_known():
    sender, receivers = Seal(RealmKey(KEY)), [Seal(RealmKey(KEY)) for _ in range(3)]
    for number, receiver in enumerate(receivers):
        receiver.meet(HELLO, sender.close(HELLO, b""))
        sender.meet(f"greeting/{number}", receiver.greet(f"greeting/{number}", b""))
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
