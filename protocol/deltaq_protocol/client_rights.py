"""What clients may say and hear in the open realm, by the role that they prove: the table beside that of topics.

The HLI asks it before it obeys, and the reference is written from it. Where no tokens are set everybody is an operator.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from deltaq_protocol import topics
from deltaq_protocol.messages import LeaseAction
from deltaq_protocol.topic import Topic


class ClientRole(IntEnum):
    """The roles of clients; each may do everything that the roles before it may."""

    OBSERVER = 1
    """Look on, and stop."""
    CONTROLLER = 2
    """Acquire a free lease, and move its robot; ask a follower for another view."""
    OPERATOR = 3
    """Take a lease from its holder, reset, allow contacts."""


@dataclass(frozen=True)
class Right:
    """One row.

    Attributes:
        topic: row of the table of topics.
        what: the action, if the topic has several; otherwise empty.
        least: the least role that may do it.
        of_holder: only the holder of the robot's lease may do it, in any role.
    """

    topic: Topic
    what: str = ""
    least: ClientRole = ClientRole.OBSERVER
    of_holder: bool = False


RIGHTS = (
    Right(topics.STATE),
    Right(topics.VERDICT),
    Right(topics.PROXIMITY),
    Right(topics.DESCRIPTION),
    Right(topics.STATUS),
    Right(topics.CHALLENGE),
    Right(topics.DRY_RUN),
    Right(topics.STOP),
    Right(topics.IO, "read"),
    Right(topics.IO, "set", of_holder=True),
    Right(topics.INCREMENT, of_holder=True),
    Right(topics.LEASE, LeaseAction.RENEW, of_holder=True),
    Right(topics.LEASE, LeaseAction.RELEASE, of_holder=True),
    Right(topics.LEASE, LeaseAction.ACQUIRE, ClientRole.CONTROLLER),
    Right(topics.LEASE, LeaseAction.TAKE, ClientRole.OPERATOR),
    Right(topics.VIEW, least=ClientRole.CONTROLLER),
    Right(topics.RESET, least=ClientRole.OPERATOR),
    Right(topics.CONTACT, least=ClientRole.OPERATOR),
)
"""The table. Outputs of a robot that nobody holds may also be set by anybody where no controller's token is set."""

_LEAST = {(right.topic.name, right.what): right.least for right in RIGHTS}


def least_role(topic: Topic, what: str = "") -> ClientRole:
    """The least role that may do something on a topic.

    Raises:
        KeyError: if the table has no such row.
    """
    return _LEAST[topic.name, what]
