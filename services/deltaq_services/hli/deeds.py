"""What the core says was done or tried, for the audit log. It knows no time of day: the shell stamps it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.guarded import Command
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.outputs import ClientOrigin


@dataclass(frozen=True, slots=True)
class Deed:
    """One thing that was done or tried.

    Attributes:
        what: it was.
        outcome: how it ended, so far.
        origin: the client that did it.
        robot: the robot that it concerned; None for no robot or all robots.
        code: why it was refused.
        text: what the client was told.
    """

    what: AuditKind
    outcome: AuditOutcome
    origin: ClientOrigin
    robot: str | None = None
    code: ReasonCode | None = None
    text: str = ""


Tell = Callable[[Deed], None]
"""Takes what was done, where it is decided."""

KIND_OF_REQUEST = {
    "stop": AuditKind.STOP,
    "reset": AuditKind.RESET,
    "io": AuditKind.OUTPUTS,
    "contact": AuditKind.CONTACT,
    "dry_run": AuditKind.DRY_RUN,
    "view": AuditKind.VIEW,
}
"""By the type of the request, which is the kind of the command that comes of it."""


def told_to_nobody(_deed: Deed) -> None:
    """Takes the deeds of a core without an audit log, and forgets them."""


def deed_of(
    command: Command,
    outcome: AuditOutcome,
    origin: ClientOrigin,
    text: str = "",
    code: ReasonCode | None = None,
) -> Deed:
    """The outcome of a command to the gate; without a text, the command's request."""
    kind = KIND_OF_REQUEST[command.kind]
    return Deed(kind, outcome, origin, command.robot, code, text or _asked_for(command))


def _asked_for(command: Command) -> str:
    match command.kind:
        case "stop":
            return f"{command.robot or 'every robot'}: {command.reason}"
        case "io":
            return ", ".join(f"{name} {'on' if on else 'off'}" for name, on in command.outputs.items())
        case "contact":
            return f"{command.contact} {'allowed' if command.allowed else 'forbidden'}"
    return ""
