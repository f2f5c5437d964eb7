"""Tables of a page, and the fields of a model as a list."""

import ast
import inspect
import json
import re
from collections.abc import Iterable
from enum import Enum
from itertools import pairwise
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

_SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥", "max_length": "length ≤"}
_PLAIN = {str: "string", int: "integer", float: "number", bool: "boolean", type(None): "null"}
NAMED = {
    "string, length ≥ 1, length ≤ 64": "name",
    "integer, ≥ 0, < 9223372036854775808": "count",
    "number, ≥ -1e+30, ≤ 1e+30": "number",
    "list of numbers, length ≥ 1, length ≤ 32": "joints",
}
"""What the bounds that most fields share are called on the pages."""


def table(columns: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    columns = list(columns)
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(_cell_text(value) for value in line) + " |" for line in lines)


def models(module: Any, base: type[BaseModel]) -> list[type[BaseModel]]:
    """The models that a module defines, in its order."""
    return [
        value
        for value in vars(module).values()
        if inspect.isclass(value)
        and issubclass(value, base)
        and value.__module__.startswith(module.__name__)
        and value is not base
    ]


def fields(model: type[BaseModel], level: int) -> str:
    """A model's fields as a list, below a heading of this level."""
    kind = model.model_fields.get("type")
    head = f"{'#' * level} {model.__name__}" + (f"\n\n`type`: `{kind.default}`" if kind else "")
    text = inspect.cleandoc(model.__doc__ or "")
    return "\n\n".join(part for part in (head, text, field_list(model)) if part)


def field_list(model: type[BaseModel]) -> str:
    """A model's fields as a list: type, bounds, default, and the text below the field in its source."""
    texts: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        if owner.__module__.startswith("deltaq"):
            texts |= _texts_in(owner)
    return "\n".join(
        f"- `{name}`: {described(field)}" + (f". {texts[name]}" if name in texts else "")
        for name, field in model.model_fields.items()
        if name != "type"
    )


def described(field: FieldInfo) -> str:
    """Type, bounds and default of a field."""
    bounded = ", ".join([type_name(field.annotation), *bounds(field)])
    for long, short in NAMED.items():
        if bounded in (long, long.replace(",", " or null,", 1)):
            bounded = short + " or null" * (bounded != long)
    return bounded if field.is_required() else f"{bounded}; default {default(field)}"


def type_name(annotation: Any) -> str:
    """A type in the words of JSON, without its bounds."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return type_name(arguments[0])
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in arguments)
    if origin in (Union, UnionType):
        return " or ".join(type_name(argument) for argument in arguments)
    if origin is dict:
        return f"map of {_several(arguments[1])}"
    if origin in (tuple, list):
        counted = "list" if Ellipsis in arguments or origin is list else str(len(arguments))
        kinds = dict.fromkeys(_several(argument) for argument in arguments if argument is not Ellipsis)
        text = re.sub(r"(\d) of (numbers|strings)", r"\1 \2", f"{counted} of {' and '.join(kinds)}")
        return text.replace("4 of 4 numbers", "pose")
    return _PLAIN.get(annotation, str(annotation.__name__))


def _several(annotation: Any) -> str:
    name = type_name(annotation)
    return f"{name}s" if name in _PLAIN.values() else name


def bounds(field: FieldInfo) -> list[str]:
    """The bounds of a field, as people write them."""
    found = []
    for item in [*field.metadata, *_metadata(field.annotation)]:
        for name, sign in _SIGNS.items():
            if (bound := getattr(item, name, None)) is not None:
                found.append(f"{sign} {bound}")
    return list(dict.fromkeys(found))


def default(field: FieldInfo) -> str:
    """The default of a field that has one."""
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel):
        return "that of its fields"
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def _metadata(annotation: Any) -> list[Any]:
    """Bounds of the parts of an alternative, e.g. of a number that may be null."""
    found: list[Any] = []
    if get_origin(annotation) is Annotated:
        for item in annotation.__metadata__:
            found += item.metadata if isinstance(item, FieldInfo) else [item]
    elif get_origin(annotation) in (Union, UnionType):
        for argument in get_args(annotation):
            found += _metadata(argument)
    return found


def message_link(message: type[BaseModel]) -> str:
    """A link to a message's fields."""
    return f"[{message.__name__}](messages.md#{message.__name__.lower()})"


def texts_of_members(members: type[Enum]) -> list[str]:
    """The text below each member of a table in its source."""
    return list(_texts_in(members).values())


def _texts_in(owner: type) -> dict[str, str]:
    (body,) = ast.parse(inspect.getsource(owner)).body
    assert isinstance(body, ast.ClassDef)  # that is what it was given
    texts: dict[str, str] = {}
    for named, below in pairwise(body.body):
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            if isinstance(named, ast.AnnAssign):
                texts[ast.unparse(named.target)] = " ".join(str(below.value.value).split())
            elif isinstance(named, ast.Assign):
                texts[ast.unparse(named.targets[0])] = " ".join(str(below.value.value).split())
    return texts


def _cell_text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value).replace("|", "\\|").replace("\n", " ")
