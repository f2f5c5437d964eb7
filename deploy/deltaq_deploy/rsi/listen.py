"""The socket and the clock under `deltaq krc`: one blocking loop that owns both and decides nothing."""

import socket
import time
from collections.abc import Callable

import numpy as np

from deltaq_deploy.rsi.statistics import WireStatistics
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.rsi import KrcTelegram, SensorCodec, TelegramError
from deltaq_protocol.rsi.layout import MAX_IPOC

_DATAGRAM_BYTES = 65_536
_POLL_S = 0.2

Responder = Callable[[bytes, str], bytes | None]


def listen(
    address: str,
    port: int,
    duration_s: float,
    statistics: WireStatistics,
    answer: Responder | None = None,
    ready: Callable[[], None] = lambda: None,
) -> None:
    """Listen until the time is over or Ctrl-C, and count datagrams.

    Args:
        address: to listen on.
        port: UDP port to listen on.
        duration_s: how long; 0 is until Ctrl-C.
        statistics: gets every datagram.
        answer: returns the reply, if any; None listens only.
        ready: called once when the socket listens.

    Raises:
        ServiceUnreachableError: the address cannot be listened on.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind((address, port))
        except OSError as error:
            raise ServiceUnreachableError(
                f"cannot listen on UDP {address}:{port}: {error.strerror or error}; is a Robot Server or another "
                "program on that port, or is the address not this machine's?"
            ) from error
        ready()
        end_s = time.monotonic() + duration_s if duration_s else float("inf")
        try:
            while (left_s := end_s - time.monotonic()) > 0:
                sock.settimeout(min(left_s, _POLL_S))
                try:
                    datagram, sender = sock.recvfrom(_DATAGRAM_BYTES)
                except TimeoutError:
                    continue
                arrived_s = time.monotonic()
                peer = f"{sender[0]}:{sender[1]}"
                if answer is not None and (reply := answer(datagram, peer)) is not None:
                    sock.sendto(reply, sender)
                    statistics.replied(time.monotonic() - arrived_s)
                statistics.saw(arrived_s, datagram, peer)
        except KeyboardInterrupt:
            return


AWAY = 2e-3
"""Distance from the start that rounding to one decimal, and a drive at rest, leave [rad or m]."""


MOST_REASONS = 16


class ZeroEcho:
    """Decides on the answer to each telegram; it has no way to send anything but zeros, digital outputs included.

    An absolute correction of zero means "back to where RSI was started": harmless at the start, and a jump for a robot
    that has been corrected already. So a robot that stands away from its start is not answered at all.

    Attributes:
        refusals: telegrams that got no answer, by reason.
    """

    def __init__(self, codec: SensorCodec) -> None:
        self._codec = codec
        self._zeros = np.zeros(codec.joints)
        self._peer: str | None = None
        self.refusals: dict[str, int] = {}

    def answer(self, datagram: bytes, peer: str) -> bytes | None:
        """The answer to a telegram, or None if it must not be answered."""
        try:
            telegram = self._codec.decode(datagram)
        except TelegramError as error:
            reason: str | None = f"no telegram of the cell's file: {str(error).partition('; got')[0]}"
        else:
            reason = self._objection(telegram, peer)
            if reason is None:
                return self._codec.encode(telegram.ipoc, self._zeros)
        if reason in self.refusals or len(self.refusals) < MOST_REASONS:
            self.refusals[str(reason)] = self.refusals.get(str(reason), 0) + 1
        return None

    def _objection(self, telegram: KrcTelegram, peer: str) -> str | None:
        self._peer = self._peer or peer
        if peer != self._peer:
            return f"{peer} is another sender than {self._peer}, which came first"
        if telegram.ipoc > MAX_IPOC:
            return f"IPOC has more than 32 bit, and a KRC's is at most {MAX_IPOC}"
        if telegram.q is None:  # the opening of a KR C2: the robot stands at its start
            return None
        if telegram.q_programmed is None:
            return "without DEF_ASPos in SEND the start position of RSI is unknown"
        away = np.abs(telegram.q - telegram.q_programmed)
        if (away > AWAY).any():
            axis = self._codec.axes.axes[int(np.argmax(away))]
            return (
                f"{axis} stands away from where RSI was started, and zero would let it jump back: end RSI and start it "
                "again"
            )
        return None
