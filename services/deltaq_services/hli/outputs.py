"""Outputs of the core for its shell: messages, and their destinations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from deltaq_protocol.messages import Message
from deltaq_protocol.topic import Topic


class Sender(ABC):
    """Destination of an answer; the fronts derive from it, the core only hands it back.

    Attributes:
        lasting: True for a connection, which can get later messages too; a query takes one answer.
    """

    lasting = False

    @abstractmethod
    def deliver(self, message: Message) -> None:
        """Send an answer; only the shell calls this."""


@dataclass(frozen=True, slots=True)
class ToGuarded:
    """Publish in the guarded realm."""

    topic: Topic
    robot: str
    """Empty where the topic has no robot in its key."""
    message: Message


@dataclass(frozen=True, slots=True)
class ToOpen:
    """Publish in the open realm; states go to the readers over TCP too."""

    topic: Topic
    robot: str
    """Empty where the topic has no robot in its key."""
    message: Message


@dataclass(frozen=True, slots=True)
class ToSender:
    """Answer one client."""

    sender: Sender
    message: Message


Output = ToGuarded | ToOpen | ToSender
