"""The Robot Server's socket: the newest of what waits is answered, and a flood does not hold it up for ever."""

import socket
from collections import Counter
from types import SimpleNamespace

from deltaq_services.robot_server.shell import _MOST_WAITING, _newest


def bound():
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    return sock


def test_of_telegrams_that_waited_the_newest_is_taken_and_the_others_are_counted():
    server = SimpleNamespace(counters=Counter())
    with bound() as sock, socket.socket(type=socket.SOCK_DGRAM) as krc:
        for number in range(100):
            krc.sendto(b"%d" % number, sock.getsockname())
        datagram, sender = _newest(sock, server)
        assert datagram == b"99"
        assert sender[1] == krc.getsockname()[1]
        assert server.counters["telegrams_skipped"] == 99


def test_a_flood_that_never_ends_is_left_after_a_bound():
    server = SimpleNamespace(counters=Counter())
    with bound() as sock:
        endless = SimpleNamespace(recvfrom=lambda _: (b"flood", sock.getsockname()))
        assert _newest(endless, server)[0] == b"flood"
    assert server.counters["telegrams_skipped"] == _MOST_WAITING


def test_a_socket_holds_fewer_telegrams_than_are_drained():
    with bound() as sock, socket.socket(type=socket.SOCK_DGRAM) as flood:
        for _ in range(4 * _MOST_WAITING):
            flood.sendto(b"x" * 300, sock.getsockname())
        held = 0
        while True:
            try:
                sock.recv(1000)
            except BlockingIOError:
                break
            held += 1
    assert 0 < held < _MOST_WAITING
