"""The socket and the clock under `deltaq krc`: one blocking loop that owns both and decides nothing."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

from deltaq_deploy.rsi.statistics import WireStatistics
from deltaq_protocol.errors import ServiceUnreachableError

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
    """Listen until the time is over or Ctrl-C, and count what comes.

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
