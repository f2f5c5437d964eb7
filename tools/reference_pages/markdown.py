"""Tables of a page, and the fields of a model as a table."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable
from enum import Enum
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

_SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥", "max_length": "length ≤"}


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
    """A model's fields as a table, below a heading of this level."""
    rows = (
        (f"`{name}`", f"`{type_name(field.annotation)}`", bounds(field), default(field))
        for name, field in model.model_fields.items()
    )
    text = inspect.cleandoc(model.__doc__ or "")
    return f"{'#' * level} {model.__name__}\n\n{text}\n\n" + table(
        ("field", "type", "bounds", "default"), rows
    )


def type_name(annotation: Any) -> str:
    """A type as people read it: without its bounds, and null for None."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is type(None):
        return "null"
    if origin is Annotated:
        return type_name(arguments[0])
    if origin is Literal:
        return " or ".join(repr(value) for value in arguments)
    if origin in (Union, UnionType):
        return " or ".join(type_name(argument) for argument in arguments)
    if arguments:
        inner = ", ".join("..." if argument is Ellipsis else type_name(argument) for argument in arguments)
        return f"{annotation.__name__}[{inner}]"
    return str(annotation.__name__)


def bounds(field: FieldInfo) -> str:
    """The bounds of a field, as people write them."""
    bounds = []
    for item in [*field.metadata, *_metadata(field.annotation)]:
        for name, sign in _SIGNS.items():
            if (bound := getattr(item, name, None)) is not None:
                bounds.append(f"{sign} {bound}")
    return ", ".join(dict.fromkeys(bounds))


def default(field: FieldInfo) -> str:
    """The default of a field."""
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    return f"`{type(default).__name__}()`" if isinstance(default, BaseModel) else f"`{default!r}`"


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


def texts_of_members(members: type[Enum] | type[BaseModel], fields: bool = False) -> list[str]:
    """The text below each member of a table in its source; `fields` may lack one."""
    body = ast.parse(inspect.getsource(members)).body[0]
    assert isinstance(body, ast.ClassDef)  # that is what it was given
    texts: list[str] = []
    for node in body.body[1:]:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            texts[len(texts) - fields :] = [" ".join(str(node.value.value).split())]
        elif fields and isinstance(node, ast.AnnAssign):
            texts.append("")
    return texts


def _cell_text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value).replace("|", "\\|").replace("\n", " ")
