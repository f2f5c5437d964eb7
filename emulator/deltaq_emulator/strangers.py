"""Others on the network who send to the PC what only the controller should, from sockets of their own."""

from __future__ import annotations

import socket
from collections.abc import Iterable

from deltaq_emulator.faults import Forgery
from deltaq_emulator.krc import Krc

MAX_SOCKETS = 16
"""Largest number of sender addresses; further ones are not opened."""


class Strangers:
    """Sends forged telegrams, one socket an address; what comes back to them is never read.

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
