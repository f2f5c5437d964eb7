"""RSI's wire with an attacker on it: carries what KRC and Robot Server send, and adds what neither did.

It does so in a thread of its own, while others start the services, look at them and bring the robot back to its work.
"""

import select
import socket
import struct
import time
from collections.abc import Callable

from deltaq_proofs.storm.forger import ForgedSender, Forger, Worker
from deltaq_proofs.storm.witness import DatagramOrigin, Passed
from deltaq_protocol.endpoint import Address

HERE = "127.0.0.1"
ELSEWHERE = "127.0.0.2"
"""Another address of the same machine, from which the KRC never sends."""

_DATAGRAM_BYTES = 65_535
_READ_A_TURN = 64
_SO_TIMESTAMPNS = 35
"""Of Linux; Python's module has no name for it."""
_TIMESPEC = struct.Struct("=qq")
_LOST, _OVERTAKEN, _TWICE = 0.0005, 0.0005, 0.01
"""Shares of the true telegrams."""
_READABLE = 4096
"""No longer datagram is a telegram."""
_HURRY_S = 0.02
"""What the attacker catches up with at most: its datagrams are spread, so that the Robot Server's loop keeps up."""


class AttackedLine(Worker):
    """The wire; a context manager.

    Args:
        server: where the Robot Server listens.
        forger: makes what is added.
        rate_hz: datagrams that are added a second.
        on_passed: called with each telegram, forgery and reply, before it is carried on.

    Attributes:
        address: where the KRC has to send to.
        forged: datagrams that were added so far.
        goal: datagrams to be added; nothing is added beyond.
    """

    def __init__(
        self, server: Address, forger: Forger, rate_hz: float, on_passed: Callable[[Passed], None]
    ) -> None:
        super().__init__("line")
        self.goal = self.forged = 0
        self._forger, self._period_s, self._on_passed = forger, 1.0 / rate_hz, on_passed
        self._to_krc = _udp(HERE)
        self._senders = {
            ForgedSender.KRC: _udp(HERE),
            ForgedSender.SECOND_KRC: _udp(HERE),
            ForgedSender.STRANGER: _udp(ELSEWHERE),
        }
        for sender in self._senders.values():
            sender.connect(server)
        self.address: Address = self._to_krc.getsockname()
        self._krc: Address | None = None
        self._overtaken: bytes | None = None

    def close(self) -> None:
        """End the work, and close the sockets."""
        super().close()
        for sock in (self._to_krc, *self._senders.values()):
            sock.close()

    def work(self) -> None:
        """Carry and attack."""
        due_s = time.monotonic()
        of_server = list(self._senders.values())
        while not self.ended.is_set():
            attacking = self.forged < self.goal
            wait_s = max(0.0, due_s - time.monotonic()) if attacking else _HURRY_S
            readable, _, _ = select.select([self._to_krc, *of_server], [], [], wait_s)
            if self._to_krc in readable:
                self._carry_telegrams()
            for sender, sock in self._senders.items():
                if sock in readable:
                    self._carry_replies(sock, sender)
            now_s = time.monotonic()
            if attacking and now_s >= due_s:
                self._attack()
                due_s = max(due_s + self._period_s, now_s - _HURRY_S)

    def _carry_telegrams(self) -> None:
        for telegram, sender, _ in _waiting(self._to_krc):
            self._krc = sender
            self._forger.overhear(telegram)
            self._on_passed(Passed(DatagramOrigin.TELEGRAM, telegram, time.time_ns()))
            if self._forger.chance(_LOST):
                continue
            if self._overtaken is None and self._forger.chance(_OVERTAKEN):
                self._overtaken = telegram
            else:
                self._send(ForgedSender.KRC, telegram)
                if self._overtaken is not None:
                    self._send(ForgedSender.KRC, self._overtaken)
                    self._overtaken = None
                if self._forger.chance(_TWICE):
                    self._send(ForgedSender.KRC, telegram)

    def _carry_replies(self, sock: socket.socket, sender: ForgedSender) -> None:
        """Whoever is answered, it is the Robot Server's setpoint that moves; the KRC gets what is meant for it."""
        for reply, _, stamp_ns in _waiting(sock):
            self._on_passed(Passed(DatagramOrigin.REPLY, reply, stamp_ns))
            if sender is ForgedSender.KRC and self._krc is not None:
                self._to_krc.sendto(reply, self._krc)

    def _attack(self) -> None:
        forgery = self._forger.forge()
        if forgery is not None and len(forgery.datagram) <= _READABLE:
            self._on_passed(Passed(DatagramOrigin.FORGERY, forgery.datagram, time.time_ns()))
        if forgery is not None and self._send(forgery.sender, forgery.datagram):
            self.forged += 1

    def _send(self, sender: ForgedSender, datagram: bytes) -> bool:
        try:
            self._senders[sender].send(datagram)
        except OSError:  # nobody listens there yet, or its buffer is full
            return False
        return True


def _udp(address: str) -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    udp.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    udp.bind((address, 0))
    return udp


def _waiting(sock: socket.socket) -> list[tuple[bytes, Address, int]]:
    """Datagrams, who sent them, and when the kernel took them in [ns]: that puts in order what came by two sockets."""
    found = []
    for _ in range(_READ_A_TURN):
        try:
            datagram, stamps, _, sender = sock.recvmsg(_DATAGRAM_BYTES, socket.CMSG_SPACE(_TIMESPEC.size))
        except OSError:  # no more, or nobody listens there yet
            break
        seconds, ns = _TIMESPEC.unpack(stamps[0][2])
        found.append((datagram, sender, seconds * 1_000_000_000 + ns))
    return found
