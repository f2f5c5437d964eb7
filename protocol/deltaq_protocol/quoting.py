"""How an error quotes a value from a client: of a value that may be a secret it names only the type.

Whoever misspells a field, gives it another type, or forgets the one beside it must not find their token in a log.
"""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import BaseModel

_LONGEST_VALUE = 80
_LONGEST_NAME = 64


def quoted(value: object, field: str, message_type: type[BaseModel]) -> str:
    """The value given for a field, as far as anybody may read it.

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
    """Where in a message something is wrong, its parts joined by dots; names that strangers made up are shortened."""
    return ".".join(_shortened(str(part), _LONGEST_NAME) for part in location) or otherwise


def _is_number(value: object) -> bool:
    return value is None or isinstance(value, bool | int | float)


def _shortened(text: str, longest: int) -> str:
    return text if len(text) <= longest else text[: longest - 3] + "..."
