"""Clients of the HLI in virtual time: any number of connections, each with wires of its own."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

from deltaq_protocol.arrays import Array
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.messages import (
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    RobotState,
    Verdict,
)
from deltaq_services.outputs import Sender
from deltaq_testing.virtual_cell.parts import MessageWire, VirtualProcess

Say = Callable[[Message | InvalidMessageError], None]
"""Sends a message to the HLI, or an invalid one."""


class VirtualClient(Protocol):
    """The program at the client's end of a connection.

    Attributes:
        robot: the robot that it drives.
        token: of its lease; None without one.
    """

    robot: str
    token: str | None

    def take(self, message: Message) -> None:
        """Take a message from the HLI."""
        ...


class ClientPort(Sender):
    """The HLI's end of a connection.

    Args:
        deliver: takes the HLI's messages.
    """

    lasting = True

    def __init__(self, deliver: Callable[[Message], None]) -> None:
        self._deliver = deliver

    def deliver(self, message: Message) -> None:
        """Answer."""
        self._deliver(message)


class Connection(VirtualProcess[VirtualClient]):
    """A client's process, and its connection to the HLI.

    Args:
        begin: makes the client at each start, from a function that sends.
        now: returns the time [s].
        to_hli: takes each message that arrives, and the sender to answer.
        up, down: wires to the HLI and from it; None for perfect ones.
    """

    def __init__(
        self,
        begin: Callable[[Say], VirtualClient],
        now: Callable[[], float],
        to_hli: Callable[[Message | InvalidMessageError, Sender], None],
        up: MessageWire | None = None,
        down: MessageWire | None = None,
    ) -> None:
        self._up, self._down = up, down
        self._now, self._to_hli = now, to_hli
        super().__init__(lambda: begin(self._say))

    def start(self) -> None:
        """Restart the client on a new connection; messages of the old one are dropped."""
        port = ClientPort(lambda message: self.tell(message) if self._port is port else None)
        self._port = port
        super().start()

    def tell(self, message: Message) -> None:
        """Send the client a message from the HLI."""
        if self._down is None or self._down.perfect:
            self._told(message)
        else:
            self._down.send(self._now(), message)

    def pump(self, now_s: float) -> None:
        """Deliver the messages that are due at `now_s`, in both directions."""
        for message in self._down.take(now_s) if self._down is not None else ():
            self._told(message)
        for message in self._up.take(now_s) if self._up is not None else ():
            self._to_hli(message, self._port)

    def _told(self, message: Message) -> None:
        self.do(partial(self.core.take, message))

    def _say(self, said: Message | InvalidMessageError) -> None:
        if self._up is None or self._up.perfect or isinstance(said, InvalidMessageError):
            self._to_hli(said, self._port)
        else:
            self._up.send(self._now(), said)


class SteppedController:
    """A controller whose increments the caller passes, one at a time.

    Args:
        robot: the robot that it drives.
        say: sends to the HLI.

    Attributes:
        robot: the robot that it drives.
        token: of its lease; None without one.
    """

    def __init__(self, robot: str, say: Say) -> None:
        self.robot, self._say = robot, say
        self.token: str | None = None
        self._seq = self._cycle = 0
        self._verdict: Verdict | None = None

    def take(self, message: Message) -> None:
        """Keep the newest message of each kind from the HLI."""
        if isinstance(message, LeaseReply):
            self.token = message.lease if message.granted else None
        elif isinstance(message, Verdict):
            self._verdict = message
        elif isinstance(message, RobotState):
            self._cycle = message.cycle

    def acquire(self, client: str) -> bool:
        """Ask for the lease; returns whether it was granted at once."""
        self._say(LeaseRequest(robot=self.robot, action=LeaseAction.ACQUIRE, client=client))
        return self.token is not None

    def ask(self, dq: Array) -> Verdict | None:
        """Answer the newest state with an increment (n,) [rad or m]; returns the newest verdict, if one has come."""
        self._seq += 1
        asked = tuple(dq.tolist())
        self._say(Increment(robot=self.robot, seq=self._seq, cycle=self._cycle, dq=asked, lease=self.token))
        verdict, self._verdict = self._verdict, None
        return verdict
