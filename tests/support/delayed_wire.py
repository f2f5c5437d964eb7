"""A wire whose messages take as long as a distribution says, and keep their order."""

from collections import deque
from collections.abc import Callable

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.messages import Message
from deltaq_testing.virtual_cell.parts import MessageWire


class _Queue(FaultyLink):
    """Tells the cell when the next message leaves."""

    def __init__(self, under_way: deque[tuple[float, Message]]) -> None:
        super().__init__()
        self.faults = LinkFaults(delay_s=1e-9)
        self._under_way = under_way

    @property
    def next_s(self) -> float | None:
        """When the next message arrives [s]; None if none is under way."""
        return self._under_way[0][0] if self._under_way else None


class DelayedWire(MessageWire):
    """One direction whose messages each take as long as is drawn, and none overtakes another, as over TCP.

    Args:
        delay_s: draws a delay [s].
    """

    def __init__(self, delay_s: Callable[[], float]) -> None:
        self._delay_s = delay_s
        self._under_way: deque[tuple[float, Message]] = deque()
        self.link = _Queue(self._under_way)

    def send(self, now_s: float, message: Message) -> None:
        """Put a message in."""
        behind_s = self._under_way[-1][0] if self._under_way else 0.0
        self._under_way.append((max(behind_s, now_s + self._delay_s()), message))

    def take(self, now_s: float) -> list[Message]:
        """Take out what has arrived by now, in order."""
        messages = []
        while self._under_way and self._under_way[0][0] <= now_s:
            messages.append(self._under_way.popleft()[1])
        return messages
