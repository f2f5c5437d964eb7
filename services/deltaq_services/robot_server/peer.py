"""The peer of a Robot Server: the one KRC whose telegrams it has believed, and no other sender."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from deltaq_protocol.endpoint import Address


class DatagramSource(StrEnum):
    """Where a datagram comes from; all but the KRC's are dropped, and counted under these names."""

    KRC = "telegrams_from_krc"
    FOREIGN = "telegrams_foreign"
    """From another address than the cell gives to the KRC, or from no port that could be answered."""
    SECOND_KRC = "telegrams_second_krc"
    """From the right address, but another port than that of the KRC that is being answered."""


@dataclass(frozen=True, slots=True)
class PeerMemory:
    """Snapshot of a `Peer`: the KRC's address, and when it was heard last."""

    address: Address | None
    heard_s: float


class Peer:
    """The sender whose telegrams are read.

    Its port is not configured: a KRC, and an emulator, choose one when they start. The port of the first valid telegram
    is kept until the KRC has been silent for `silence_s`; then the next valid telegram determines it.

    Args:
        krc_address: the KRC's address; None on the loopback, where any sender may be the first.
        silence_s: time of silence after which the KRC may send from another port [s].

    Attributes:
        address: of the KRC; None while it is not known.
        stranger: the sender dropped last, for people; empty if none was.
    """

    def __init__(self, krc_address: str | None, silence_s: float) -> None:
        self.address: Address | None = None
        self.stranger = ""
        self._krc_address = krc_address
        self._silence_s = silence_s
        self._heard_s = 0.0

    def judge(self, sender: Address, now_s: float) -> DatagramSource:
        """The sender of a datagram, before a byte of it is read.

        Args:
            sender: its address and port.
            now_s: on a monotonic clock.
        """
        if sender == self.address:
            return DatagramSource.KRC
        host, port = sender
        if port == 0 or self._krc_address not in (None, host):
            self.stranger = f"a stranger at {host}:{port}"
            return DatagramSource.FOREIGN
        if self.address is None or now_s - self._heard_s > self._silence_s:
            return DatagramSource.KRC
        self.stranger = f"a second KRC at {host}:{port}"
        return DatagramSource.SECOND_KRC

    def snapshot(self) -> PeerMemory:
        """Snapshot of all that judgements depend on, for `restore`."""
        return PeerMemory(self.address, self._heard_s)

    def restore(self, memory: PeerMemory) -> None:
        """Go on from where another peer was."""
        self.address, self._heard_s = memory.address, memory.heard_s

    def believed(self, sender: Address, now_s: float) -> None:
        """A telegram of this sender was valid."""
        if sender != self.address:
            self.stranger = ""  # it may have been this one
        self.address, self._heard_s = sender, now_s
