"""The socket between a Robot Server and its KRC: nothing that arrives on it, and no error of it, ends the process."""

import errno
import logging
import select
import socket
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import Self

from deltaq_cell.description import RsiDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.rsi import TelegramError
from deltaq_protocol.rsi.sensor_codec import MAX_TELEGRAM_BYTES
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.containment import Containment
from deltaq_services.robot_server.crash_brake.watch import CrashRecordMaker, CrashWatch
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.session import DatagramSource, Peer

_log = logging.getLogger(__name__)

_DATAGRAM_BYTES = MAX_TELEGRAM_BYTES + 1
"""Read of a datagram: enough to see that it is too long."""

_LOOK_S = 0.02
"""Between two tries to have an address that is taken."""

MOST_WAITING = 1024
"""Datagrams drained before one is answered: more than a socket holds, so that nothing but a flood is cut short."""

MOST_READ = 8
"""Of the datagrams from the KRC's address, this many of the newest are read in search of a valid telegram."""


class KrcSocket:
    """Takes telegrams from one KRC and answers it.

    Args:
        driver: gives address and port of this server, and the KRC's address.
        silence_s: time of silence after which the KRC may use another port.
        rsi: reads telegrams.
        counters: are added to.
        patience_s: greatest time to wait for the address: after a Robot Server's death the brake process holds it
            until the robot rests.

    Attributes:
        peer: the sender that is answered.
        newest: the datagram that was read last; empty if none was valid.
        came_s: when it came, on the monotonic clock.
        watch: gets a record of every setpoint before it is sent; None for none.

    Raises:
        ServiceUnreachableError: if the address is in use, or that of the KRC is not known.
    """

    def __init__(
        self,
        driver: RsiDescription,
        silence_s: float,
        rsi: RsiDriver,
        counters: Counter[str],
        patience_s: float = 0.0,
    ) -> None:
        self.peer = Peer(_resolved(driver.krc_address), silence_s)
        self._rsi = rsi
        self._counters = counters
        self.newest, self.came_s = b"", 0.0
        self.watch: CrashWatch | None = None
        self._sock = _bound(driver, patience_s)
        self._sender: Address | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._sock.close()

    @property
    def socket(self) -> socket.socket:
        """The socket itself, for the process that answers the KRC after this one."""
        return self._sock

    @property
    def is_guarded(self) -> bool:
        """Whether a process is ready to brake the robot should this one die, where one is wanted."""
        return self.watch is None or self.watch.ready

    def wait(self, seconds: float) -> bool:
        """Wait so long for a datagram; whether there is one."""
        return bool(select.select([self._sock], [], [], max(0.0, seconds))[0])

    @property
    def detail(self) -> str:
        """Details of the KRC, as text."""
        step = self._rsi.session.step
        ipoc = "" if step is None else f"IPOC grows by {step} a cycle"
        watch = "" if self.watch is None else self.watch.detail
        tick = "" if self._rsi.meter is None else self._rsi.meter.detail
        return "; ".join(filter(None, (watch, self._rsi.detail, self.peer.stranger, ipoc, tick)))

    def read(self, now_s: float) -> Measurement | None:
        """Read the newest of all waiting telegrams.

        Args:
            now_s: on a monotonic clock.

        Returns:
            What it measures; None if there is none to be answered with a setpoint, see `RsiDriver.read`.
        """
        self._rsi.unmoved, self.newest, self.came_s = None, b"", now_s
        waiting = self._drain(now_s)
        while waiting:
            datagram, sender = waiting.pop()
            try:
                measured = self._rsi.read(datagram, now_s)
            except TelegramError as error:
                self._counters["telegrams_garbled"] += 1
                if self._counters["telegrams_garbled"] == 1:
                    _log.warning("first garbled telegram: %s", error)
                continue
            if self._rsi.implausible and self._counters["telegrams_implausible"] == 1:
                _log.warning("first implausible telegram: %s", self._rsi.implausible)
            self._skipped(len(waiting))
            self._sender, self.newest = sender, datagram
            self.peer.believed(sender, now_s)
            return measured
        return None

    def send_setpoint(self, reply: bytes, record: bytes | None) -> None:
        """Answer the telegram that was read last, and leave a record of it before; see `CrashWatch.write`."""
        if self.watch is None:
            self.send(reply)
            return
        assert self._sender is not None  # there is no reply without a telegram
        self.watch.write(record, self._sender, self.came_s)
        self.send(reply)
        self.watch.sent()

    def send(self, reply: bytes) -> None:
        """Answer the telegram that was read last."""
        assert self._sender is not None  # there is no reply without a telegram
        try:
            self._sock.sendto(reply, self._sender)
        except OSError:  # no route, no buffer, no receiver: to the KRC it is a lost reply
            self._counters["replies_unsent"] += 1

    def _drain(self, now_s: float) -> deque[tuple[bytes, Address]]:
        """The newest datagrams of the KRC, oldest first; older ones are past their time, others are not its own."""
        waiting: deque[tuple[bytes, Address]] = deque(maxlen=MOST_READ)
        for datagram, sender in self._arrived():
            who = self.peer.judge(sender, now_s)
            if who is not DatagramSource.KRC:
                self._counters[who] += 1
                continue
            self._skipped(len(waiting) // MOST_READ)
            waiting.append((datagram, sender))
        return waiting

    def _arrived(self) -> Iterator[tuple[bytes, Address]]:
        """What waits in the socket."""
        for _ in range(MOST_WAITING):
            try:
                datagram, sender = self._sock.recvfrom(_DATAGRAM_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except OSError:  # an earlier reply found nobody there
                self._counters["socket_errors"] += 1
                continue
            yield datagram, sender

    def _skipped(self, count: int) -> None:
        if count:
            self._counters["telegrams_skipped"] += count


class RsiRobot:
    """A robot on RSI, see `Driver`: its KRC's datagram is the only clock.

    Args:
        rsi: its telegrams.
        krc: its socket.
        silence_s: after which the KRC counts as lost.
        records: makes those that are left before replies; None if none are.
    """

    def __init__(
        self, rsi: RsiDriver, krc: KrcSocket, silence_s: float, records: CrashRecordMaker | None = None
    ) -> None:
        self._rsi, self._krc, self._records = rsi, krc, records
        self._silence_s, self._silent_s = silence_s, time.monotonic() + silence_s
        self._undo = Containment()
        self._reply, self._outputs, self._ipoc = b"", dict[str, bool](), 0

    @property
    def is_guarded(self) -> bool:
        """Whether a process is ready to brake the robot should this one die, where one is wanted."""
        return self._krc.is_guarded

    @property
    def detail(self) -> str:
        """Details of the KRC, as text."""
        return self._krc.detail

    @property
    def q_sent(self) -> Array:
        """(n,) setpoint that the KRC was sent last [rad or m]."""
        return self._rsi.q_sent

    def wait(self) -> float:
        """Wait for a datagram, until the KRC counts as lost."""
        self._krc.wait(self._silent_s - time.monotonic())
        return time.monotonic()

    def read(self, now_s: float) -> Measurement | None:
        """Read the newest telegram; one that must not be answered with a setpoint is answered here."""
        self._undo.remember((self._rsi, self._rsi.session))
        try:
            measured = self._krc.read(now_s)
        except Exception:
            self._undo.put_back()
            raise
        if measured is not None:
            self._silent_s, self._ipoc = now_s + self._silence_s, measured.ipoc
        elif self._rsi.unmoved is not None:
            self._krc.send(self._rsi.unmoved)
        return measured

    def is_lost(self, now_s: float) -> bool:
        """Whether the KRC has been silent for this time; if so, the time starts again."""
        if now_s < self._silent_s:
            return False
        self._silent_s = now_s + self._silence_s
        return True

    def write(self, q_cmd: Array, outputs: Mapping[str, bool], stop: bool) -> bool:
        """Make the reply; whether the last check took it."""
        self._reply, self._outputs = self._rsi.reply(q_cmd, outputs, stop), dict(outputs)
        return self._rsi.fault is None

    def send(self, motion: SetpointMotion) -> None:
        """Leave the record of the reply, and send it."""
        record = None
        if self._records is not None:
            record = self._records.body(
                self._records.of_last(self._krc.newest, self._ipoc, self._outputs, motion)
            )
        self._krc.send_setpoint(self._reply, record)

    def mend(self, now_s: float) -> None:
        """Start another process in place of one that was to brake the robot, and has ended."""
        if self._krc.watch is not None:
            self._krc.watch.mend(now_s)


def _resolved(address: str | None) -> str | None:
    if address is None:
        return None
    try:
        return socket.gethostbyname(address)
    except OSError as error:
        raise ServiceUnreachableError(
            f"krc_address {address!r} is not known: {error}; give the KRC's address in numbers"
        ) from error


def _bound(driver: RsiDescription, patience_s: float) -> socket.socket:
    place = f"UDP {driver.address}:{driver.port}"
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end_s, told = time.monotonic() + patience_s, False
    while True:
        try:
            sock.bind((driver.address, driver.port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE and time.monotonic() < end_s:
                if not told:
                    _log.info("waits for %s: a robot may still be braked there", place)
                told = True
                time.sleep(_LOOK_S)
                continue
            sock.close()
            raise ServiceUnreachableError(
                f"cannot listen for RSI on {place}: {error.strerror}; "
                "is another Robot Server running, or the address not this machine's?"
            ) from error
        return sock
