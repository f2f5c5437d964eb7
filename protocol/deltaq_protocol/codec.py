"""Bytes to messages and back: msgpack on zenoh, JSON lines over TCP.

Both go through pydantic, so a decoded message is a valid one. Errors name the field, its value, and what is
allowed.
"""

import json
from collections.abc import Iterable
from typing import Any, TypeVar

import msgpack
from pydantic import BaseModel, ValidationError

from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.messages import Message
from deltaq_protocol.reasons import ReasonCode

M = TypeVar("M", bound=Message)

MAX_MESSAGE_BYTES = 64 * 1024
"""Longest message and longest JSON line; descriptions are sent as replies to queries and may be longer."""
MAX_ZENOH_MESSAGE_BYTES = 1024 * 1024
"""Largest message that a session reassembles; descriptions with their URDF texts are the largest."""


class InvalidMessageError(ProtocolError):
    """Bytes that are no valid message of the expected type.

    Attributes:
        code: `bad_shape` or `not_finite` if `dq` is at fault, otherwise `malformed`.
        data: the decoded map, if it got that far, so that an answer can name its sequence number.
    """

    def __init__(self, message: str, code: ReasonCode, data: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.data = data or {}


def pack(message: Message) -> bytes:
    """Encode a message as a msgpack map."""
    packed: bytes = msgpack.packb(message.__dict__, default=_fields)
    return packed


def _fields(part: BaseModel) -> dict[str, Any]:
    """A part of a message, as msgpack meets it; `model_dump` would copy the whole message first."""
    return part.__dict__


def unpack(message_type: type[M], payload: bytes, max_bytes: int = MAX_MESSAGE_BYTES) -> M:
    """Decode a msgpack map.

    Raises:
        InvalidMessageError: if the bytes are no valid message of that type.
    """
    if len(payload) > max_bytes:
        raise InvalidMessageError(
            f"message is {len(payload)} bytes long, at most {max_bytes} are allowed", ReasonCode.MALFORMED
        )
    try:
        data = msgpack.unpackb(payload)
    except Exception as error:  # msgpack raises many unrelated types on damaged input
        raise InvalidMessageError(f"not a msgpack map: {error}", ReasonCode.MALFORMED) from error
    return from_map(message_type, data)


def to_line(message: Message) -> bytes:
    """Encode a message as one JSON line."""
    return message.model_dump_json(exclude_unset=False).encode() + b"\n"


def line_to_map(line: bytes) -> dict[str, Any]:
    """Decode one JSON line to a map, without looking at its fields.

    Raises:
        InvalidMessageError: if the line is not one JSON object.
    """
    try:
        data = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InvalidMessageError(f"not a JSON object: {error}", ReasonCode.MALFORMED) from error
    if not isinstance(data, dict):
        raise InvalidMessageError(
            f"a line must be one JSON object, got {type(data).__name__}", ReasonCode.MALFORMED
        )
    return data


def from_map(message_type: type[M], data: object) -> M:
    """Validate a decoded map as a message.

    Raises:
        InvalidMessageError: the message names the first wrong field, the allowed values, and its value unless that
            may be a secret.
    """
    try:
        # encoded data has lists where a message has tuples, and names where it has enumerations
        return message_type.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        text = f"{place(first['loc'], message_type.__name__)}: {first['msg']}"
        if first["type"] != "missing":  # its input would be all that is there
            text += f", got {quoted(first['input'], str(next(iter(first['loc']), '')), message_type)}"
        raise InvalidMessageError(
            text,
            _code_of(first["loc"], first["type"], first["input"]),
            data if isinstance(data, dict) else None,
        ) from error


_NO_INCREMENT = ("finite_number", "less_than_equal", "greater_than_equal")
"""What is wrong with an element of `dq` that is a number, as pydantic names it."""


def _code_of(location: tuple[int | str, ...], kind: str, value: object) -> ReasonCode:
    if location and location[0] == "dq":
        if kind in _NO_INCREMENT or (len(location) > 1 and value is None):
            return ReasonCode.NOT_FINITE
        if len(location) == 1:
            return ReasonCode.BAD_SHAPE
    return ReasonCode.MALFORMED


# How an error quotes a value from a client: of a value that may be a secret it names only the type. Whoever misspells a
# field, gives it another type, or forgets the one beside it must not find their token in a log.

_LONGEST_VALUE = 80
_LONGEST_NAME = 64


def quoted(value: object, field: str, message_type: type[BaseModel]) -> str:
    """The value of a field as text for an error message, without secrets.

    Numbers and text are quoted if the message has that field and its `repr` shows it. Of a value in a field of another
    name, in a map, or in a secret field, only the kind is named.
    """
    known = message_type.model_fields.get(field)
    return shown(value) if known is not None and known.repr else kind_of(value)


def shown(value: object) -> str:
    """A number, a text or numbers in a row, shortened; anything else by its kind."""
    is_plain = _is_number(value) or isinstance(value, str)
    if is_plain or (isinstance(value, list | tuple) and all(map(_is_number, value))):
        return _shortened(repr(value), _LONGEST_VALUE)
    return kind_of(value)


def kind_of(value: object) -> str:
    """The kind of a value, without its contents."""
    match value:
        case None:
            return "null"
        case bool():
            return "true or false"
        case int() | float():
            return "a number"
        case str():
            return f"a text of {len(value)} characters"
        case bytes():
            return f"{len(value)} bytes"
        case list() | tuple():
            return f"a list of {len(value)}"
        case dict():
            return f"a map of {len(value)} fields"
    return f"a {type(value).__name__}"


def place(location: Iterable[int | str], otherwise: str = "") -> str:
    """Where in a message something is wrong, its parts joined by dots; unknown names are shortened."""
    return ".".join(_shortened(str(part), _LONGEST_NAME) for part in location) or otherwise


def _is_number(value: object) -> bool:
    return value is None or isinstance(value, bool | int | float)


def _shortened(text: str, longest: int) -> str:
    return text if len(text) <= longest else text[: longest - 3] + "..."
