"""The emulated controller as a process: one loop, one thread, sockets and time.

The loop keeps absolute deadlines: it sends in every cycle, with or without replies, as a real controller does. If the
machine holds it up for longer than a cycle, the emulated time stands still instead of catching up in a burst, and the
slip is counted. A reply that is missing in a cycle that this process itself began late does not count against the PC.
"""

import select
import socket
import time
from collections.abc import Callable, Iterable
from functools import partial

from deltaq_emulator.faults import FaultyLink, Forgery
from deltaq_emulator.krc import Krc
from deltaq_emulator.panel import Panel
from deltaq_emulator.recorder import CsvRecorder
from deltaq_protocol.endpoint import Address
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.heartbeat import Heartbeat

# Other senders on the network, whose forged telegrams reach the PC from their own sockets.

MAX_SOCKETS = 16
"""Largest number of sender addresses; further ones are not opened."""


class Strangers:
    """Sends forged telegrams, one socket an address; replies to them are not read.

    Args:
        server: host and port of the PC.

    Attributes:
        lost: forgeries that could not be sent.
    """

    def __init__(self, server: tuple[str, int]) -> None:
        self._server = server
        self._sockets: dict[str, socket.socket] = {}
        self.lost = 0

    def send(self, krc: Krc, forgeries: Iterable[Forgery]) -> None:
        """Send each forgery of the telegram of this cycle."""
        for forgery in forgeries:
            try:
                self._socket(forgery.address).sendto(krc.forged(forgery), self._server)
            except OSError:
                self.lost += 1

    def close(self) -> None:
        """Close the sockets."""
        for sender in self._sockets.values():
            sender.close()

    def _socket(self, address: str) -> socket.socket:
        if address not in self._sockets:
            if len(self._sockets) >= MAX_SOCKETS:
                raise OSError("too many addresses")
            sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                sender.setblocking(False)
                sender.bind((address, 0))
            except OSError:
                sender.close()
                raise
            self._sockets[address] = sender
        return self._sockets[address]


MAX_READ = 64
"""Datagrams read in one go, so that a flood cannot hold up the cycle."""
MAX_DATAGRAM = 65535
LATE_START = 0.25
"""A cycle that begins later than this fraction of a cycle has been held up by the machine."""


class Emulator:
    """An emulated controller with its sockets.

    Args:
        robot: its name in the cell.
        krc: the controller.
        server: address of the Robot Server.
        panel: address of the operator's panel; None for none.
        seed: of the network's faults.
        address: of the controller itself, which telegrams come from; None: as the system chooses.

    Raises:
        DeltaqError: if an address cannot be resolved or is taken.
    """

    def __init__(
        self,
        robot: str,
        krc: Krc,
        server: Address,
        panel: Address | None = None,
        seed: int = 0,
        address: str | None = None,
    ) -> None:
        self._krc = krc
        self._to_pc, self._from_pc = FaultyLink(seed), FaultyLink(seed + 1)
        self.recorder = CsvRecorder(krc.cycle_s, len(krc.sample.q))
        self.counts = {"slipped": 0, "late_starts": 0, "latest_start_us": 0, "send_errors": 0}
        """Cycles that were lost because the machine held up this process; cycles that began late, and the largest delay
        [µs]; telegrams that could not be sent."""
        self._panel = Panel(robot, krc, self._to_pc, self._from_pc, self.recorder, self._all_counts)
        self._sent_at = 0.0
        self._heartbeat = Heartbeat()
        self._link = _udp_socket()
        self._strangers = Strangers(server)
        self._panel_socket = None if panel is None else _udp_socket()
        if self._panel_socket is not None and panel is not None:
            try:  # before the link, which may be given any free port
                self._panel_socket.bind(panel)
            except OSError as error:
                self.close()
                raise DeltaqError(f"cannot listen on {panel[0]}:{panel[1]}: {error}") from error
        try:
            if address is not None:
                self._link.bind((address, 0))
            # connected: a controller takes replies from its sensor only
            self._link.connect(server)
        except OSError as error:
            self.close()
            sender = "" if address is None else f"from {address} "
            raise DeltaqError(f"cannot send {sender}to {server[0]}:{server[1]}: {error}") from error

    def _all_counts(self) -> dict[str, int]:
        return self.counts | {"forgeries_lost": self._strangers.lost}

    def close(self) -> None:
        """Close sockets and the record."""
        self._link.close()
        self._heartbeat.close()
        self._strangers.close()
        if self._panel_socket is not None:
            self._panel_socket.close()
        self.recorder.stop()

    def run(self, stopping: Callable[[], bool], ready: Callable[[], None] = lambda: None) -> None:
        """Send and receive until `stopping()`; `ready` is called once, when the first cycle has begun."""
        deadline, slipped_s = time.monotonic(), 0.0
        first, held_up = True, False
        while not stopping():
            now = time.monotonic()
            late_s = now - deadline
            if late_s > self._krc.cycle_s:
                slipped_s += late_s
                self.counts["slipped"] = int(slipped_s / self._krc.cycle_s)
                deadline = now
            held_up_before, held_up = held_up, late_s > LATE_START * self._krc.cycle_s
            self._count_start(late_s, held_up)
            # this cycle began late, or was held up while the PC's reply was due
            telegram = self._krc.tick(excused=held_up_before or held_up)
            self._sent_at = now
            if telegram is not None:
                self._to_pc.put(now, telegram)
                self._send(now)
                self._strangers.send(self._krc, self._panel.forgeries)
            self.recorder.row(self._krc.sample)
            self._panel.cycle_passed()
            if self._heartbeat.is_due(now):
                self._heartbeat.beat(now, detail=str(self._krc.message or self._krc.state))
            if first:
                first = False
                ready()
            deadline += self._krc.cycle_s
            self._receive_until(deadline)

    def _count_start(self, late_s: float, held_up: bool) -> None:
        self.counts["late_starts"] += held_up
        self.counts["latest_start_us"] = max(self.counts["latest_start_us"], round(late_s * 1e6))

    def _receive_until(self, deadline: float) -> None:
        sockets = [self._link] if self._panel_socket is None else [self._link, self._panel_socket]
        now = time.monotonic()
        while True:
            dues = [due for due in (self._to_pc.next_s, self._from_pc.next_s) if due is not None]
            timeout = max(min([deadline, *dues]) - now, 0.0)
            readable, _, _ = select.select(sockets, [], [], timeout)
            now = time.monotonic()
            if self._panel_socket in readable:
                self._answer_operator()
            if self._link in readable:
                self._read_link(now)
            # datagrams that waited in the socket while this process was held up were not late
            age_s = now - self._sent_at if now < deadline else 0.0
            for datagram in self._from_pc.take(now):
                self._krc.receive(datagram, age_s)
            self._send(now)
            if now >= deadline:
                return

    def _read_link(self, now: float) -> None:
        for _ in range(MAX_READ):
            try:
                self._from_pc.put(now, self._link.recv(MAX_DATAGRAM))
            except BlockingIOError:
                return
            except OSError:
                # no PC listens there (yet); the telegram is lost, as on any network
                self.counts["send_errors"] += 1

    def _send(self, now: float) -> None:
        for datagram in self._to_pc.take(now):
            try:
                self._link.send(datagram)
            except OSError:
                self.counts["send_errors"] += 1

    def _answer_operator(self) -> None:
        assert self._panel_socket is not None  # it was readable
        for _ in range(MAX_READ):
            try:
                request, sender = self._panel_socket.recvfrom(MAX_DATAGRAM)
            except BlockingIOError:
                return
            except OSError:
                self.counts["send_errors"] += 1
                continue
            self._panel.take(request, partial(self._tell_operator, sender))

    def _tell_operator(self, sender: Address, answer: bytes) -> None:
        assert self._panel_socket is not None  # that is where the request came in
        try:
            self._panel_socket.sendto(answer, sender)
        except OSError:
            self.counts["send_errors"] += 1


def _udp_socket() -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    return udp
