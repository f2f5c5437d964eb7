"""Wires of the cell that is made to suffer: messages as bytes through the emulator's faulty links, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.messages import Message

_PERFECT = LinkFaults()


class MessageWire:
    """One direction between two processes; while nothing ails it, messages arrive at once and untouched.

    Args:
        deliver: called with each message that arrives.
        seed: of the link's random numbers.

    Attributes:
        link: its faults may be set at any time.
    """

    def __init__(self, deliver: Callable[[Message], None], seed: int) -> None:
        self.link = FaultyLink(seed)
        self._deliver = deliver
        self._kinds: dict[str, type[Message]] = {}

    def send(self, now_s: float, message: Message) -> None:
        """Put a message in."""
        if self.link.faults == _PERFECT and self.link.next_s is None:
            self._deliver(message)
            return
        kind = type(message)
        self._kinds[kind.__name__] = kind
        self.link.put(now_s, kind.__name__.encode() + b"\n" + pack(message))

    def pump(self, now_s: float) -> None:
        """Deliver what has arrived by now."""
        for datagram in self.link.take(now_s):
            name, _, payload = datagram.partition(b"\n")
            kind = self._kinds.get(name.decode(errors="replace"))
            if kind is None:
                continue  # garbled beyond knowing what it was
            try:
                message = unpack(kind, payload)
            except InvalidMessageError:
                continue
            self._deliver(message)


def next_arrival_s(links: Iterable[FaultyLink]) -> float | None:
    """When the next datagram of any of these arrives."""
    return min((due for link in links if (due := link.next_s) is not None), default=None)
