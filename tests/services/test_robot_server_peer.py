"""Whom a Robot Server listens to."""

import pytest

from deltaq_services.robot_server.session import DatagramSource, Peer

KRC = ("127.0.0.1", 40_000)
OTHER = ("127.0.0.1", 40_001)
SILENCE_S = 0.25


def test_on_the_loopback_the_first_valid_telegram_names_the_krc():
    peer = Peer(None, SILENCE_S)
    assert (peer.address, peer.stranger) == (None, "")
    assert peer.judge(OTHER, 0.0) is DatagramSource.KRC
    assert peer.judge(KRC, 0.0) is DatagramSource.KRC  # the other has not said anything valid
    peer.believed(KRC, 0.0)
    assert peer.judge(KRC, 0.1) is DatagramSource.KRC
    assert peer.judge(OTHER, 0.1) is DatagramSource.SECOND_KRC
    assert peer.stranger == "a second KRC at 127.0.0.1:40001"


def test_the_krc_may_come_from_another_port_after_it_was_silent():
    peer = Peer(None, SILENCE_S)
    peer.believed(KRC, 0.0)
    peer.believed(KRC, 1.0)
    assert peer.judge(OTHER, 1.0 + SILENCE_S) is DatagramSource.SECOND_KRC
    assert peer.judge(OTHER, 1.01 + SILENCE_S) is DatagramSource.KRC
    peer.believed(OTHER, 1.3)
    assert peer.judge(KRC, 1.3) is DatagramSource.SECOND_KRC
    assert peer.address == OTHER


def test_who_turns_out_to_be_the_krc_is_no_stranger():
    peer = Peer(None, SILENCE_S)
    peer.believed(KRC, 0.0)
    peer.judge(OTHER, 0.1)
    peer.believed(KRC, 0.1)
    assert peer.stranger
    peer.believed(OTHER, 1.0)
    assert peer.stranger == ""


@pytest.mark.parametrize("learned", [False, True])
def test_nobody_but_the_krcs_own_address_is_listened_to(learned):
    peer = Peer("192.168.10.20", SILENCE_S)
    if learned:
        peer.believed(("192.168.10.20", 49_152), 0.0)
    for now_s in (0.0, 9.0):
        assert peer.judge(("192.168.10.66", 49_152), now_s) is DatagramSource.FOREIGN
        assert peer.stranger == "a stranger at 192.168.10.66:49152"
        assert peer.judge(("192.168.10.20", 49_152), now_s) is DatagramSource.KRC


def test_a_sender_without_a_port_could_not_be_answered():
    peer = Peer(None, SILENCE_S)
    assert peer.judge(("127.0.0.1", 0), 0.0) is DatagramSource.FOREIGN
