"""What controllers in virtual time have in common: the lease, and who hears what the HLI says."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from deltaq_protocol.messages import (
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    RobotState,
    Verdict,
)


class LeasingClient(ABC):
    """Holds a robot's lease.

    Args:
        say: sends to the HLI.
        robot: that it drives.

    Attributes:
        token: of its lease; None without one.
        answers: whether it answers states; a controller that gets no processor time does not.
    """

    def __init__(self, say: Callable[[Message], None], robot: str) -> None:
        self.robot = robot
        self.token: str | None = None
        self.answers = False
        self._say, self._seq = say, 0

    def acquire(self) -> None:
        """Ask for the lease."""
        self._say(LeaseRequest(robot=self.robot, action=LeaseAction.ACQUIRE, client="virtual"))

    def take(self, message: Message) -> None:
        """The HLI has said something."""
        if isinstance(message, LeaseReply):
            self.token = message.lease
        elif isinstance(message, Verdict):
            self.take_verdict(message)
        elif isinstance(message, RobotState) and self.answers:
            self.take_state(message)

    @abstractmethod
    def take_verdict(self, verdict: Verdict) -> None:
        """A verdict has come."""

    @abstractmethod
    def take_state(self, state: RobotState) -> None:
        """A state has come, and is to be answered."""

    def ask(self, cycle: int, dq: tuple[float, ...]) -> None:
        """Send the next increment, under the number that `_seq` has."""
        self._say(Increment(robot=self.robot, seq=self._seq, cycle=cycle, dq=dq, lease=self.token))
