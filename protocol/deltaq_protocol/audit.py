"""Entries of the audit log: who did what, from where, in which role, and how it ended."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from deltaq_protocol.messages import Count, Message, Real
from deltaq_protocol.reasons import ReasonCode

LONGEST_NAME = 64
LONGEST_ADDRESS = 80
LONGEST_TEXT = 300
"""Greatest length of text from a client in an entry; longer text is cut."""


class AuditKind(StrEnum):
    """The kind of action, done or attempted."""

    CONNECTED = "connected"
    DISCONNECTED = "disconnected"
    LEASE_GRANTED = "lease_granted"
    LEASE_TAKEN_OVER = "lease_taken_over"
    LEASE_RELEASED = "lease_released"
    LEASE_EXPIRED = "lease_expired"
    LEASE_LOST = "lease_lost"
    LEASE_REFUSED = "lease_refused"
    STOP = "stop"
    RESET = "reset"
    OUTPUTS = "outputs"
    CONTACT = "contact"
    TOOL = "tool"
    DRY_RUN = "dry_run"
    VIEW = "view"
    NOTE = "note"
    INCREMENT = "increment"
    MESSAGE = "message"


class AuditOutcome(StrEnum):
    """Result of an action.

    `asked`: the gate was asked. `done`: it was carried out. `unconfirmed`: it is not known whether it was.
    """

    ASKED = "asked"
    DONE = "done"
    REFUSED = "refused"
    UNCONFIRMED = "unconfirmed"


class AuditEntry(Message):
    """One line of the audit log, written by the HLI.

    `time_utc` is the wall clock's time in ISO 8601, `time_s` the HLI's monotonic time [s]. `client` is the name that
    the client gives itself, `identity` the name that its certificate proved (`operator-NAME`, `controller-NAME`).
    `address` is HOST:PORT of a TCP connection, or `zenoh`, which does not show addresses. `role` is the role that was
    proved (`observer`, `controller`, `operator`); empty if none was required. `text` is the answer to the client.
    `count` is the number of equal entries that this one stands for; client, address and text are then those of the
    newest.
    """

    time_utc: str
    time_s: Real
    what: AuditKind
    outcome: AuditOutcome
    robot: str | None = None
    client: Annotated[str, Field(max_length=LONGEST_NAME)] = ""
    address: Annotated[str, Field(max_length=LONGEST_ADDRESS)] = ""
    role: str = ""
    identity: Annotated[str, Field(max_length=LONGEST_NAME)] = ""
    code: ReasonCode | None = None
    text: Annotated[str, Field(max_length=LONGEST_TEXT)] = ""
    count: Count = 1
