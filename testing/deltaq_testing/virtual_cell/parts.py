"""The parts of a cell in virtual time: processes that can die, freeze and restart, and the links between them."""

from collections import deque
from collections.abc import Callable
from enum import Enum, StrEnum
from typing import Generic, TypeVar

from deltaq_emulator.faults import FaultyLink, LinkFaults
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.messages import Message

T = TypeVar("T")


class Process(StrEnum):
    """Processes to which faults apply."""

    CONTROLLER = "controller"
    HLI = "hli"
    SIM = "sim"
    ROBOT_SERVER = "robot-server"
    RECORDER = "recorder"


class Link(StrEnum):
    """A wire between two processes; a fault affects both directions."""

    CONTROLLER_HLI = "controller-hli"
    HLI_SIM = "hli-sim"
    HLI_SERVER = "hli-server"
    SIM_SERVER = "sim-server"
    KRC_SERVER = "krc-server"


class Life(Enum):
    """State of a process."""

    RUNNING = 0
    FROZEN = 1
    DEAD = 2


_RING = 64
"""Greatest number of messages that wait for a frozen process, as in the SIM's ring channel."""


class VirtualProcess(Generic[T]):
    """Runs its tasks at once; while frozen it queues them until it is thawed; once dead it drops them.

    Args:
        begin: makes the program that runs in it, at each start.

    Attributes:
        core: the program that runs in it.
        life: its state; it begins running.
    """

    def __init__(self, begin: Callable[[], T]) -> None:
        self._begin = begin
        self._waiting: deque[Callable[[], None]] = deque(maxlen=_RING)
        self.start()

    def start(self) -> None:
        """Start or restart, with a new core."""
        self.core = self._begin()
        self.life = Life.RUNNING

    def kill(self) -> None:
        """End at once, and drop the queue."""
        self.life = Life.DEAD
        self._waiting.clear()

    def freeze(self) -> None:
        """Freeze: queue tasks from now on."""
        self.life = Life.FROZEN

    def thaw(self) -> None:
        """Run the queued tasks, and then further ones at once."""
        self.life = Life.RUNNING
        while self._waiting:
            self._waiting.popleft()()

    def do(self, act: Callable[[], None]) -> None:
        """Run a task now; or queue it while frozen, or drop it once dead."""
        if self.life is Life.RUNNING:
            act()
        elif self.life is Life.FROZEN:
            self._waiting.append(act)


_PERFECT = LinkFaults()


class MessageWire:
    """One direction of a wire between two processes; its faults may be set at any time.

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
        """Whether it has no faults and carries no message, so that a message may be delivered directly."""
        return self.link.faults == _PERFECT and self.link.next_s is None

    def send(self, now_s: float, message: Message) -> None:
        """Send a message."""
        kind = type(message)
        self._kinds[kind.__name__] = kind
        self.link.put(now_s, kind.__name__.encode() + b"\n" + pack(message))

    def take(self, now_s: float) -> list[Message]:
        """Return the messages that have arrived by now, in order; unreadable ones are dropped."""
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
