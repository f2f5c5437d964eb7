"""Questions that are no lease, and their answers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from deltaq_protocol.messages.base import Joints, Message, Name, Secret
from deltaq_protocol.messages.motion import Verdict
from deltaq_protocol.reasons import ReasonCode


class StopRequest(Message):
    """Bring every robot of the cell to rest; anyone may."""

    type: Literal["stop"] = "stop"
    client: str | None = Field(default=None, max_length=64)


class ResetRequest(Message):
    """Leave `held`; refused while the cause persists, and to others than the operator where the HLI knows one.

    `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["reset"] = "reset"
    robot: Name
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class DryRunRequest(Message):
    """Ask for the gate's verdict on an increment if it came now; nothing moves, and no lease is needed."""

    type: Literal["dry_run"] = "dry_run"
    robot: Name
    dq: Joints


class DryRunReply(Message):
    """The verdict that the gate would have given; its `seq` is 0."""

    type: Literal["dry_run"] = "dry_run"
    robot: Name
    verdict: Verdict


class ContactRequest(Message):
    """Let bodies touch that a contact of the cell names, or forbid it again; an operator's privilege.

    `token` is never sent, as in `LeaseRequest`.
    """

    type: Literal["contact"] = "contact"
    contact: Name
    allowed: bool
    client: str | None = Field(default=None, max_length=64)
    token: Secret = None


class ChallengeRequest(Message):
    """Ask for a challenge, which the operator's next request over zenoh answers, or the hello of a TCP client."""

    type: Literal["challenge"] = "challenge"


class Challenge(Message):
    """Nonce of the proof beside a request of the operator, or in a hello, in hexadecimal digits; good once."""

    type: Literal["challenge"] = "challenge"
    challenge: Annotated[str, Field(max_length=128, pattern=r"^([0-9a-f]{2})+$", repr=False)]


class Done(Message):
    """A stop, a reset or a change of contacts was carried out.

    After a stop every robot is held, or offline; after a reset the robot is not held any more: its state has shown it.
    If it is not confirmed in time, the answer is the error `unreachable`; the gate was asked nevertheless.
    """

    type: Literal["done"] = "done"
    what: str


class IoRequest(Message):
    """Set digital outputs by name; the reply has all outputs and inputs.

    While a robot is leased only the holder sets its outputs; anybody may read. `lease` is never sent, as in
    `Increment`.
    """

    type: Literal["io"] = "io"
    robot: Name
    outputs: dict[str, bool] = Field(default_factory=dict, max_length=64)
    lease: Secret = None


class IoReply(Message):
    """Digital outputs and inputs of a robot."""

    type: Literal["io"] = "io"
    robot: Name
    outputs: dict[str, bool] = {}
    inputs: dict[str, bool] = {}


class Error(Message):
    """A message that could not be served, and why.

    `request` is the type of the message that it answers; `robot` and `seq` are that message's, as far as it had any.
    An error that answers no message, such as the loss of a lease, has no `request`.
    """

    type: Literal["error"] = "error"
    code: ReasonCode
    message: str
    hint: str = ""
    request: str | None = None
    robot: str | None = None
    seq: int | None = None
