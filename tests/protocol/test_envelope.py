"""Envelopes of guarded messages: what is old, repeated, replaced or for another process is refused."""

import pytest

from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.envelope import (
    Envelopes,
    MisaddressedError,
    StaleMessageError,
    message_in,
    sender_of,
)
from deltaq_protocol.sayings import HLI, SIM

FR, GR = "robot-server-fr", "robot-server-gr"
STATE, ADMISSION, REQUEST, HEALTH = (
    f"deltaq-guarded/lab/{key}" for key in ("fr/state", "fr/admission", "fr/request", "health/sim")
)


def process(service):
    """A new process of a service."""
    return Envelopes(service, "lab", ("fr", "gr"))


@pytest.fixture
def gate():
    return process(SIM)


@pytest.fixture
def server():
    return process(FR)


def meet(gate, server):
    """The gate hears a state."""
    gate.open(STATE, server.close(STATE, b"state"))


def test_an_opened_envelope_returns_the_message_unchanged(gate, server):
    assert gate.open(STATE, server.close(STATE, b"\x00state\xff")) == b"\x00state\xff"


def test_an_admission_is_addressed_to_the_known_process(gate, server):
    early = gate.close(ADMISSION, b"early")
    meet(gate, server)
    assert server.open(ADMISSION, gate.close(ADMISSION, b"dq")) == b"dq"
    with pytest.raises(MisaddressedError):
        server.open(ADMISSION, early)


def test_a_replayed_message_is_ignored_by_a_newer_process(gate, server):
    meet(gate, server)
    recorded = [gate.close(ADMISSION, b"dq") for _ in range(3)]
    successor = process(FR)
    for enclosed in recorded:
        with pytest.raises(MisaddressedError):
            successor.open(ADMISSION, enclosed)


def test_each_message_is_accepted_once_and_never_after_a_newer_one(gate, server):
    first, second = (server.close(STATE, text) for text in (b"first", b"second"))
    gate.open(STATE, second)
    for late in (second, first):
        with pytest.raises(StaleMessageError, match="2 has come already"):
            gate.open(STATE, late)


def test_messages_under_different_keys_do_not_overtake_one_another(gate):
    hli = process(HLI)
    health, verdict = gate.close(HEALTH, b"health"), gate.close(HEALTH, b"again")
    assert hli.open(HEALTH, health) == b"health"
    assert hli.open(HEALTH, verdict) == b"again"


def test_a_frozen_process_is_ignored_after_its_successor(gate, server):
    meet(gate, server)
    successor = process(FR)
    meet(gate, successor)
    health = "deltaq-guarded/lab/health/robot-server-fr"
    for key in (STATE, health):
        with pytest.raises(StaleMessageError, match="was replaced"):
            gate.open(key, server.close(key, b"woken"))
    assert gate.open(STATE, successor.close(STATE, b"on")) == b"on"
    # nor does the gate speak to it any more
    with pytest.raises(MisaddressedError):
        server.open(ADMISSION, gate.close(ADMISSION, b"dq"))


def test_a_robot_server_ignores_a_frozen_gate_after_its_successor(gate, server):
    meet(gate, server)
    server.open(ADMISSION, gate.close(ADMISSION, b"dq"))
    successor = process(SIM)
    meet(successor, server)
    server.open(ADMISSION, successor.close(ADMISSION, b"dq"))
    with pytest.raises(StaleMessageError, match="was replaced"):
        server.open(ADMISSION, gate.close(ADMISSION, b"dq"))


def test_a_misaddressed_message_replaces_no_peer(gate):
    """A recorded HLI does not take the place of the one that runs."""
    hli, recorded = process(HLI), process(HLI)
    hli.open(HEALTH, gate.close(HEALTH, b"health"))
    gate.open(REQUEST, hli.close(REQUEST, b"dq"))
    with pytest.raises(MisaddressedError):
        gate.open(REQUEST, recorded.close(REQUEST, b"dq"))
    assert gate.open(REQUEST, hli.close(REQUEST, b"dq")) == b"dq"


def test_robot_servers_accept_no_message_of_each_other_or_of_the_hli(server):
    with pytest.raises(StaleMessageError, match="nothing there is for robot-server-fr"):
        server.open(STATE, process(FR).close(STATE, b"state"))
    with pytest.raises(StaleMessageError, match="nothing there is for robot-server-fr"):
        server.open(REQUEST, process(HLI).close(REQUEST, b"dq"))


def test_a_damaged_message_or_one_under_another_key_is_invalid(gate, server):
    enclosed = server.close(STATE, b"state")
    damaged = [enclosed[:-1], b"", enclosed[:20]]
    damaged += [
        enclosed[:place] + bytes([enclosed[place] ^ 1 << bit]) + enclosed[place + 1 :]
        for place in range(len(enclosed))
        for bit in range(8)
    ]
    for each in damaged:
        with pytest.raises(InvalidMessageError, match="damaged bytes"):
            gate.open(STATE, each)
    with pytest.raises(InvalidMessageError):
        gate.open("deltaq-guarded/lab/gr/state", enclosed)
    assert gate.open(STATE, enclosed) == b"state"


def test_an_observer_reads_a_message_for_others_with_its_sender(gate, server):
    meet(gate, server)
    first, second = (gate.close(ADMISSION, b"dq") for _ in range(2))
    assert message_in(first) == message_in(second) == b"dq"
    assert sender_of(first) == sender_of(second) != sender_of(server.close(STATE, b"state"))
