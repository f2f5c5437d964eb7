"""Pydantic's errors about a YAML file as problems with file, line, field, value and bound."""

from __future__ import annotations

import types
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

from deltaq_cell.models import nearest_name
from deltaq_cell.problems import Problem
from deltaq_cell.yaml_source import Scalar, YamlNode, shown


def problem_of(tree: YamlNode, error: dict[str, Any], root: type[BaseModel]) -> Problem:
    """One of pydantic's errors as a problem with its place.

    Args:
        tree: of the file.
        error: one of `ValidationError.errors()`.
        root: the model that the file was validated as.
    """
    loc = tuple(part for part in error["loc"] if part != "[key]")
    node, trail = tree.find(loc)
    context = error.get("ctx", {})
    kind, given = error["type"], error.get("input")
    value: Scalar = None if isinstance(given, (dict, list)) else shown(given)
    bound: str | int | float | None = None
    suggestion: str | None = None
    field = ".".join(str(part) for part in trail)
    if kind == "missing":
        field = ".".join(str(part) for part in (*trail, loc[-1]))
        message, value = "is missing", None
    elif kind == "extra_forbidden":
        allowed = _fields_at(loc[:-1], root)
        suggestion = nearest_name(str(loc[-1]), allowed)
        bound, value = ", ".join(allowed), None
        message = "not a field here" + ("" if suggestion else f"; the fields here are {bound}")
    elif kind in ("union_tag_invalid", "literal_error", "union_tag_not_found"):
        expected = str(context.get("expected_tags", context.get("expected", "")))
        names = [name.strip(" '") for name in expected.replace(" or ", ",").split(",") if name.strip()]
        tag = str(context.get("discriminator", "")).strip("'")
        field = ".".join([field, tag]).strip(".") if tag else field
        if isinstance(node.value, dict) and tag in node.value:
            node = node.value[tag]
        value = shown(context.get("tag", value))
        bound = ", ".join(names) or None
        suggestion = nearest_name(str(value), names)
        message = (
            f"must be one of {bound}, got {value!r}" if bound else "is missing: it says what kind this is"
        )
    elif kind == "value_error":
        message = str(context.get("error", error["msg"]))
    else:
        bound = next((context[key] for key in _BOUNDS if key in context), None)
        message = error["msg"].replace("Input should", "should").replace("String should", "should")
        got = "a list" if isinstance(given, list) else "a mapping" if isinstance(given, dict) else repr(value)
        message = f"{message[0].lower()}{message[1:]}, got {got}"
    if suggestion:
        message += f"; did you mean '{suggestion}'?"
    return Problem(node.file, node.line, field, message, value, bound, suggestion)


_BOUNDS = ("gt", "ge", "lt", "le", "min_length", "max_length", "pattern")


def _fields_at(loc: tuple[str | int, ...], root: type[BaseModel]) -> list[str]:
    """Names of the fields that a model has at a place that a validation error names."""
    models: list[Any] = [root]
    for part in loc:
        models = [below for model in models for below in _below(model, part)]
    return sorted({name for model in models for name in model.model_fields})


def _below(model: Any, part: str | int) -> list[Any]:
    """The models that field or key `part` of a model can hold."""
    annotation = model.model_fields[part].annotation if part in model.model_fields else None
    if annotation is None:
        # a key of a mapping or the branch of a union: the models below are those found before
        return [model]
    return _models_in(annotation)


def _models_in(annotation: Any) -> list[Any]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Annotated, Union, types.UnionType, dict, list, tuple):
        return [model for argument in get_args(annotation) for model in _models_in(argument)]
    return []
