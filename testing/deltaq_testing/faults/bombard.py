"""A second sender that sends foreign datagrams to a Robot Server beside its KRC, as a thread of its own."""

import socket
import struct
import threading
from contextlib import suppress
from typing import Self

from deltaq_protocol.endpoint import Address
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.catalogue import Bombard
from deltaq_testing.virtual_cell.arm import HERE

OVERSIZE = 5000
"""Bytes behind a telegram that make it longer than any."""

_PERIOD_S = 0.002
_TELEGRAM = b'<Rob TYPE="KUKA"><IPOC>1</IPOC></Rob>'
_UDP_HEADER = struct.Struct("!HHHH")


class Bomber:
    """A second sender; a context manager that sends while inside.

    Args:
        how: kind of datagrams.
        to: address of the Robot Server.

    Raises:
        DeltaqError: if this user may not send from port 0.
    """

    def __init__(self, how: Bombard, to: Address) -> None:
        self._to = to
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._bomb, name="bomber")
        if how is Bombard.OVERSIZED:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._datagram = _TELEGRAM + b" " * OVERSIZE
            return
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_UDP)
        except PermissionError as error:
            raise DeltaqError(
                "only a privileged user may send from port 0; leave out krc-port-zero, or run it as root"
            ) from error
        header = _UDP_HEADER.pack(0, to[1], _UDP_HEADER.size + len(_TELEGRAM), 0)
        self._datagram = header + _TELEGRAM
        self._to = (HERE, 0)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()

    def _bomb(self) -> None:
        while not self._ended.wait(_PERIOD_S):
            with suppress(OSError):  # no Robot Server listens there, or its buffer is full
                self._socket.sendto(self._datagram, self._to)
