"""Outputs of the console's core for its shell, and the requests that await answers."""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

from deltaq_protocol import driving
from deltaq_protocol.messages import Message, ViewWish
from deltaq_services.console.client import Client
from deltaq_services.console.messages import Ack, AckOutcome


@dataclass(frozen=True, slots=True)
class ToClient:
    """Send to one browser; `client` is its number."""

    client: int
    message: Message


@dataclass(frozen=True, slots=True)
class AskHli:
    """Ask the HLI, and give the core its answer to `request`; `client` is the sender's name for the audit log."""

    kind: Literal["stop", "reset", "dry_run", "view"]
    robot: str = ""
    dq: tuple[float, ...] = ()
    view: ViewWish = field(default_factory=ViewWish)
    request: str = ""
    client: str = "console"


@dataclass(frozen=True, slots=True)
class ToDriver:
    """Send to the robot's driver, which is started if none runs."""

    robot: str
    request: driving.DriverRequest


@dataclass(frozen=True, slots=True)
class ToRecorder:
    """Begin to write a recording of this name, or end the one that is written."""

    file: str | None


ConsoleOutput = ToClient | AskHli | ToDriver | ToRecorder


Awaited = tuple[Client | None, str, AskHli | ToDriver | None]
"""The waiting client, its command, and the request; None if no client waits."""


class PendingRequests:
    """Requests that await an answer."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._asked: dict[str, Awaited] = {}

    def new_id(self) -> str:
        """An id that no request had before."""
        return f"r{next(self._numbers)}"

    def ask(self, client: Client, command: str, asked: AskHli) -> list[ConsoleOutput]:
        """Ask the HLI, and tell the client so."""
        asked = replace(asked, request=self.new_id(), client=client.in_the_audit_log)
        self._asked[asked.request] = (client, command, asked)
        return [asked, acknowledged(client, command, AckOutcome.ASKED, "asked")]

    def send(self, requests: Iterable[ToDriver], client: Client | None, command: str) -> list[ConsoleOutput]:
        """Send requests to drivers; motion commands get no answer."""
        sent: list[ConsoleOutput] = []
        for request in requests:
            sent.append(request)
            if request.request.id is not None:
                self._asked[request.request.id] = (client, command, request)
        return sent

    def answered(self, request: str) -> Awaited:
        """End the wait for a request; returns its subject."""
        return self._asked.pop(request, (None, "", None))

    def given_up(self, robot: str) -> list[Awaited]:
        """Drop and return the requests that a robot's driver will not answer."""
        lost = [
            request
            for request, (_, _, asked) in self._asked.items()
            if isinstance(asked, ToDriver) and asked.robot == robot
        ]
        return [self._asked.pop(request) for request in lost]


def acknowledged(client: Client, command: str, outcome: AckOutcome, text: str) -> ToClient:
    """The answer to a client's command."""
    return ToClient(client.number, Ack(id=command, outcome=outcome, text=text))
