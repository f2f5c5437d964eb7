"""What the core wants done, for its shell."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from deltaq_protocol import driving
from deltaq_protocol.messages import Message, ViewWish


@dataclass(frozen=True, slots=True)
class ToClient:
    """Send to one browser; `client` is its number."""

    client: int
    message: Message


@dataclass(frozen=True, slots=True)
class AskHli:
    """Ask the HLI, and give the core its answer to `request`; `client` is the sender's name for the audit log."""

    request: str
    kind: Literal["stop", "reset", "dry_run", "view"]
    robot: str = ""
    dq: tuple[float, ...] = ()
    view: ViewWish = field(default_factory=ViewWish)
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
