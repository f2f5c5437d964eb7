"""Leases: the right to move a robot."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

from pydantic import Field

from deltaq_protocol.messages.base import Message, Name, Real, Secret
from deltaq_protocol.reasons import ReasonCode


class LeaseAction(StrEnum):
    """Actions on the lease of a robot; `take` is a hand-over against the holder's will."""

    ACQUIRE = "acquire"
    RENEW = "renew"
    RELEASE = "release"
    TAKE = "take"


class LeaseRequest(Message):
    """Ask for the right to write to a robot: one writer a robot, any number of readers.

    `take` needs the operator where the HLI has been given the operator's token. `token` and `lease` are never sent, and
    not read if they are: over zenoh proofs stand for them (`deltaq_protocol.proof`), over TCP the hello and the
    connection.

    `playout` is for a controller that is far away: increments wait for their turn (`Playout`).
    """

    type: Literal["lease"] = "lease"
    robot: Name
    action: LeaseAction
    playout: bool = False
    client: str | None = Field(default=None, max_length=64)
    lease: Secret = None
    token: Secret = None


class LeaseReply(Message):
    """Whether the lease was granted, its present holder, and the token: the secret that the holder proves to have.

    The token comes once, to the client that was granted the lease, and never over TCP.
    """

    type: Literal["lease"] = "lease"
    robot: Name
    granted: bool
    holder: str | None = None
    expires_s: Real | None = None
    lease: Secret = None
    code: ReasonCode | None = None
