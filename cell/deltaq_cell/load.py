"""Load a cell's description from its YAML file, with errors that point into the file."""

from __future__ import annotations

import json
import types
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from deltaq_cell.description import CellDescription
from deltaq_cell.find import find_cell, is_file, resolve_near
from deltaq_cell.models import SHIPPED, nearest_name
from deltaq_cell.problems import CellError, Problem
from deltaq_cell.yaml_tree import Scalar, YamlNode, cell_tree, merge, parse, read, shown

__all__ = [
    "find_cell",
    "load_as",
    "load_cell",
    "load_located",
    "load_with_text",
    "parse_cell",
    "resolve_near",
]

Model = TypeVar("Model", bound=BaseModel)

EXTENDS = "extends"
"""Key at the top of a cell file: another cell (by path beside it, or by name) that this one changes."""

REMOVABLE = ("robots", "structure", "contacts", "equipment", "bodies", "tools")
"""Sections in which a cell that extends another removes an entry by setting it to null."""


def load_cell(name_or_path: str | Path) -> CellDescription:
    """Load the description of a cell.

    Args:
        name_or_path: name of a cell (`lab`) or path of a YAML file; see `deltaq_cell.find.find_cell`.

    Raises:
        CellError: no such cell, or its file has errors; the error lists all of them.
    """
    return load_located(name_or_path)[0]


def load_located(name_or_path: str | Path) -> tuple[CellDescription, YamlNode]:
    """Like `load_cell`, with the tree that gives the file and line of every value."""
    tree = _read_with_bases(find_cell(name_or_path))[1]
    return _validated(tree, CellDescription), tree


def parse_cell(text: str, source: str = "cell") -> CellDescription:
    """The description in a YAML text, e.g. one that came over the network; `source` names it in messages.

    Raises:
        CellError: the text has errors.
    """
    return _validated(cell_tree(text, source), CellDescription)


def load_with_text(name_or_path: str | Path) -> tuple[CellDescription, str]:
    """The description of a cell and its YAML text, both from one reading of its file.

    If the cell extends another, the texts are merged, so that the result stands alone.

    Raises:
        CellError: no such cell, or its file has errors.
    """
    text, tree, extended = _read_with_bases(find_cell(name_or_path))
    return _validated(tree, CellDescription), _merged(tree) if extended else text


def _merged(tree: YamlNode) -> str:
    # in the order of the keys, which is that of the joints
    return yaml.safe_dump(tree.plain(), sort_keys=False, allow_unicode=True)


def _read_with_bases(path: Path, seen: tuple[Path, ...] = ()) -> tuple[str, YamlNode, bool]:
    """Text and tree of a file, merged with the cells that it extends, and whether it extends any."""
    text, tree = read(path)
    assert isinstance(tree.value, dict)  # read() ensures it
    _resolve_models(tree, path)
    base_name = tree.value.pop(EXTENDS, None)
    if base_name is None:
        return text, tree, False
    if not isinstance(base_name.value, str):
        raise _extends_error(base_name, "must be the name or the path of one cell")
    try:
        base = _find_base(path, base_name.value)
    except CellError as error:
        raise _extends_error(base_name, f"'{base_name.value}': {error.problems[0].message}") from None
    if base.resolve() in (*seen, path.resolve()):
        raise _extends_error(base_name, f"'{base_name.value}' extends this file in turn")
    return text, merge(_read_with_bases(base, (*seen, path.resolve()))[1], tree, REMOVABLE), True


def _find_base(path: Path, name: str) -> Path:
    """The file that `path` extends: beside it, or a cell that is found by name."""
    beside = path.parent / name
    if is_file(beside):
        return beside
    try:
        return find_cell(name)
    except CellError:
        if beside.suffix:
            find_cell(beside)  # the error names the files beside it
        raise


def _resolve_models(tree: YamlNode, path: Path) -> None:
    """Turn the path of a robot's URDF, which is relative to the cell's file, into one that is valid anywhere."""
    robots = tree.value.get("robots") if isinstance(tree.value, dict) else None
    for robot in robots.value.values() if robots and isinstance(robots.value, dict) else ():
        model = robot.value.get("model") if isinstance(robot.value, dict) else None
        if model is None or not isinstance(model.value, str) or model.value in SHIPPED:
            continue
        beside = path.resolve().parent / model.value
        if is_file(beside) and isinstance(robot.value, dict):
            robot.value["model"] = YamlNode(str(beside), model.file, model.line)


def _extends_error(node: YamlNode, message: str) -> CellError:
    return CellError([Problem(node.file, node.line, EXTENDS, message, value=shown(node.value))])


def load_as(root: type[Model], path: Path) -> Model:
    """What a YAML file of another kind than a cell's says.

    Raises:
        CellError: it cannot be read or has errors; the error lists all of them.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CellError([Problem(str(path), 0, "", f"cannot be read: {error}")]) from None
    return _validated(parse(text, path.name), root)


def _validated(tree: YamlNode, root: type[Model]) -> Model:
    try:
        # as JSON, because strict validation takes JSON's lists for tuples but no text for numbers
        return root.model_validate_json(json.dumps(tree.plain()), strict=True)
    except ValidationError as error:
        problems = (problem_of(tree, dict(item), root) for item in error.errors())
        raise CellError(sorted(problems, key=lambda problem: (problem.file, problem.line))) from None


# Pydantic's errors about a YAML file as problems with file, line, field, value and bound.


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
        message = f"must be one of {bound}, got {value!r}" if bound else "is missing: it selects the kind"
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
    """The models possible as field or key `part` of a model."""
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
