"""Wires between the processes of a cell in virtual time: messages as bytes through the emulator's faulty links."""

from __future__ import annotations

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.messages import Message

_PERFECT = LinkFaults()


class MessageWire:
    """One direction between two processes; its faults may be set at any time.

    Args:
        seed: of the link's random numbers.

    Attributes:
        link: carries the messages.
    """

    def __init__(self, seed: int = 0) -> None:
        self.link = FaultyLink(seed)
        self._kinds: dict[str, type[Message]] = {}

    @property
    def perfect(self) -> bool:
        """Whether nothing ails it and nothing is under way, so that a message may pass it by, at once and untouched."""
        return self.link.faults == _PERFECT and self.link.next_s is None

    def send(self, now_s: float, message: Message) -> None:
        """Put a message in."""
        kind = type(message)
        self._kinds[kind.__name__] = kind
        self.link.put(now_s, kind.__name__.encode() + b"\n" + pack(message))

    def take(self, now_s: float) -> list[Message]:
        """Take out what has arrived by now, in order; what was garbled beyond reading is lost."""
        messages = []
        for datagram in self.link.take(now_s):
            name, _, payload = datagram.partition(b"\n")
            kind = self._kinds.get(name.decode(errors="replace"))
            if kind is None:
                continue
            try:
                messages.append(unpack(kind, payload))
            except InvalidMessageError:
                continue
        return messages
