"""From a browser's bytes to a command, or to words that say what is wrong with them."""

from __future__ import annotations

import json
from typing import Any

from pydantic import ValidationError

from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.quoting import place, shown
from deltaq_services.console.commands import COMMANDS, MAX_MESSAGE_BYTES, AnyCommand

_BOUNDS = ("gt", "ge", "lt", "le", "min_length", "max_length", "expected", "expected_tags", "pattern")


class InvalidCommandError(ProtocolError):
    """A message that is not a valid command; the text names field, value and bound.

    Attributes:
        id: of the command, as far as it had one.
    """

    def __init__(self, text: str, command_id: str = "") -> None:
        super().__init__(text)
        self.id = command_id


def command_of(message: str | bytes) -> AnyCommand:
    """The command in a message.

    Raises:
        InvalidCommandError: there is none in it.
    """
    if isinstance(message, bytes):
        raise InvalidCommandError(f"message: must be text, got {len(message)} bytes")
    # a browser may send half a surrogate pair, which is no text
    length = len(message.encode(errors="replace"))
    if length > MAX_MESSAGE_BYTES:
        raise InvalidCommandError(f"message: {length} bytes long, at most {MAX_MESSAGE_BYTES} are allowed")
    try:
        return COMMANDS.validate_json(message)
    except ValidationError as error:
        raise InvalidCommandError(_words(dict(error.errors(include_url=False)[0])), id_in(message)) from None
    except UnicodeEncodeError:
        raise InvalidCommandError("message: is not UTF-8 text") from None


def _words(error: dict[str, Any]) -> str:
    # the first part of a place is the kind of the command
    field = place(error["loc"][1:]) or place(error["loc"])
    context = error.get("ctx", {})
    if error["type"].startswith("union_tag"):
        field = "type"
    elif error["type"] == "missing":
        return f"{field}: is missing"
    elif error["type"] == "extra_forbidden":
        return f"{field}: is not a field of a {error['loc'][0]}"
    bound = next((context[name] for name in _BOUNDS if name in context), None)
    given = error["input"]
    if field == "type" and isinstance(given, dict):
        given = given.get("type")
    text = f"{field or 'message'}: {error['msg'].removeprefix('Input ')}, got {shown(given)}"
    return text if bound is None or error["type"].endswith("tag_invalid") else f"{text}; bound {bound}"


def id_in(message: str | bytes) -> str:
    """The id in a message, as far as it has one."""
    try:
        data = json.loads(message)
    except (ValueError, RecursionError):
        return ""
    command_id = data.get("id") if isinstance(data, dict) else None
    return command_id if isinstance(command_id, str) and 0 < len(command_id) <= 64 else ""
