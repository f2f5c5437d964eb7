"""What a line of a client asks for, by its `type`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deltaq_protocol.codec import InvalidMessageError, from_map
from deltaq_protocol.messages import (
    LINE_VERSIONS,
    ChallengeRequest,
    ContactRequest,
    DescribeRequest,
    DryRunRequest,
    Hello,
    Increment,
    IoRequest,
    LeaseRequest,
    Message,
    ResetRequest,
    StopRequest,
    ViewRequest,
)
from deltaq_protocol.quoting import shown
from deltaq_protocol.reasons import ReasonCode

REQUESTS: dict[str, type[Message]] = {
    "challenge": ChallengeRequest,
    "hello": Hello,
    "lease": LeaseRequest,
    "increment": Increment,
    "io": IoRequest,
    "stop": StopRequest,
    "reset": ResetRequest,
    "dry_run": DryRunRequest,
    "contact": ContactRequest,
    "view": ViewRequest,
    "describe": DescribeRequest,
}
"""What a client may say, by the `type` of its line."""


def request_type(data: dict[str, Any]) -> type[Message]:
    """What a line asks for.

    Raises:
        InvalidMessageError: nothing that a client may say.
    """
    kind = data.get("type")
    message_type = REQUESTS.get(kind) if isinstance(kind, str) else None
    if message_type is None:
        text = f"type: must be one of {', '.join(REQUESTS)}, got {shown(kind)}"
        raise InvalidMessageError(text, ReasonCode.MALFORMED, data)
    return message_type


def hello_of(data: dict[str, Any]) -> Hello:
    """The hello; one of another version may have fields that this one does not know.

    Raises:
        InvalidMessageError: it is none.
    """
    protocol = data.get("protocol")
    if isinstance(protocol, int) and protocol not in LINE_VERSIONS:
        data = {"type": "hello", "protocol": protocol, "client": "of another version"}
    return from_map(Hello, data)


def of_client(request: Message, client: Hello, leases: Mapping[str, str]) -> Message:
    """A request with the name, token and lease that the connection has for its client; the line's own are replaced.

    Args:
        request: as the line has it.
        client: the hello of the connection.
        leases: token of each robot's lease that was granted to it.
    """
    fields: dict[str, str | None] = {}
    match request:
        case LeaseRequest():
            fields = {"lease": leases.get(request.robot), "client": client.client, "token": client.token}
        case IoRequest():
            fields = {"lease": leases.get(request.robot)}
        case ContactRequest() | ResetRequest() | ViewRequest():
            fields = {"token": client.token}
    return request.model_copy(update=fields)
