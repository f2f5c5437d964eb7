"""What cores want sent, for their shells: messages and setpoints, and their destinations."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Message
from deltaq_protocol.topic import Realm, Topic


@dataclass(frozen=True, slots=True)
class ClientOrigin:
    """The sender of a message, for the audit log.

    Attributes:
        client: the name that it gives itself.
        address: HOST:PORT of its connection, or `zenoh`; empty for the server itself.
        role: the role that it has proved; empty if none was required.
        identity: the name that its certificate proved; empty without one.
    """

    client: str = ""
    address: str = ""
    role: str = ""
    identity: str = ""


NOBODY = ClientOrigin()
"""The server itself, or an unknown sender."""


class Sender(ABC):
    """Destination of an answer; the fronts derive from it, the core only hands it back.

    Attributes:
        lasting: True for a connection, which can get later messages too; a query takes one answer.
        origin: the sender's name, address and role, as far as they are known.
    """

    lasting = False
    origin = NOBODY

    @abstractmethod
    def deliver(self, message: Message) -> None:
        """Send an answer; only the shell calls this."""


@dataclass(frozen=True, slots=True)
class ToTopic:
    """Publish in the realm of the topic; states go to the readers over TCP too.

    Attributes:
        robot: robot of the key; empty if the topic's key has no robot.
    """

    topic: Topic
    robot: str
    message: Message


@dataclass(frozen=True, slots=True)
class ToSender:
    """Answer one client."""

    sender: Sender
    message: Message


@dataclass(frozen=True, slots=True)
class ToRobot:
    """Send to a robot in answer to a measurement.

    Attributes:
        q_cmd: (n,) setpoint [rad or m].
        outputs: digital outputs by name.
        motion_stop: the KRC has to end the motion itself.
    """

    q_cmd: Array
    outputs: Mapping[str, bool]
    motion_stop: bool


Output = ToTopic | ToSender


def published(outputs: Iterable[Output], realm: Realm) -> list[ToTopic]:
    """Outputs to publish in a realm."""
    return [output for output in outputs if isinstance(output, ToTopic) and output.topic.realm is realm]
