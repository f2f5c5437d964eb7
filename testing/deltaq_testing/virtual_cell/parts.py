"""What a cell consists of: processes that can die, stand still and start anew, and the links between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum, StrEnum
from typing import Generic, TypeVar

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.messages import Message

T = TypeVar("T")


class Process(StrEnum):
    """What can die, freeze or be slow."""

    CONTROLLER = "controller"
    HLI = "hli"
    SIM = "sim"
    ROBOT_SERVER = "robot-server"
    RECORDER = "recorder"


class Link(StrEnum):
    """A wire between two processes; both directions share its fate."""

    CONTROLLER_HLI = "controller-hli"
    HLI_SIM = "hli-sim"
    HLI_SERVER = "hli-server"
    SIM_SERVER = "sim-server"
    KRC_SERVER = "krc-server"


class Life(Enum):
    """Whether a process runs, stands still or is gone."""

    RUNNING = 0
    FROZEN = 1
    DEAD = 2


_RING = 64
"""Messages that wait for a process that stands still, as the SIM's ring channel keeps them."""


class VirtualProcess(Generic[T]):
    """Does what comes while it runs, afterwards what came while it stood still, and nothing once it is dead.

    Args:
        begin: makes what runs in it, anew at each start.

    Attributes:
        core: what runs in it.
        life: it runs from the beginning.
    """

    def __init__(self, begin: Callable[[], T]) -> None:
        self._begin = begin
        self._waiting: deque[Callable[[], None]] = deque(maxlen=_RING)
        self.start()

    def start(self) -> None:
        """Start, or start anew."""
        self.core = self._begin()
        self.life = Life.RUNNING

    def kill(self) -> None:
        """End at once; what waited is lost."""
        self.life = Life.DEAD
        self._waiting.clear()

    def freeze(self) -> None:
        """Stand still."""
        self.life = Life.FROZEN

    def thaw(self) -> None:
        """Go on, with what has waited."""
        self.life = Life.RUNNING
        while self._waiting:
            self._waiting.popleft()()

    def do(self, act: Callable[[], None]) -> None:
        """Something has come, to be done at once, later or never."""
        if self.life is Life.RUNNING:
            act()
        elif self.life is Life.FROZEN:
            self._waiting.append(act)


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
