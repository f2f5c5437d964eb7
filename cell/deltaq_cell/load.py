"""Load a cell's description from its YAML file, with errors that point into the file."""

from __future__ import annotations

import json
from pathlib import Path

import yaml
from pydantic import ValidationError

from deltaq_cell.description import CellDescription
from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.models import SHIPPED
from deltaq_cell.packages import is_file
from deltaq_cell.problems import CellError, Problem
from deltaq_cell.validation import problem_of
from deltaq_cell.yaml_source import YamlNode, merge, shown
from deltaq_cell.yaml_tree import cell_tree, read

__all__ = ["find_cell", "load_cell", "load_located", "load_with_text", "parse_cell", "resolve_near"]

EXTENDS = "extends"
"""Key at the top of a cell file: another cell (by path beside it, or by name) that this one changes."""

REMOVABLE = ("robots", "structure", "contacts")
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
    return _validated(tree), tree


def parse_cell(text: str, source: str = "cell") -> CellDescription:
    """The description in a YAML text, e.g. one that came over the network; `source` names it in messages.

    Raises:
        CellError: the text has errors.
    """
    return _validated(cell_tree(text, source))


def load_with_text(name_or_path: str | Path) -> tuple[CellDescription, str]:
    """The description of a cell and its YAML text, both from one reading of its file.

    If the cell extends another, the texts are merged, so that the result stands alone.

    Raises:
        CellError: no such cell, or its file has errors.
    """
    text, tree, extended = _read_with_bases(find_cell(name_or_path))
    return _validated(tree), _merged(tree) if extended else text


def _merged(tree: YamlNode) -> str:
    # in the order of the keys, which is that of the joints
    return yaml.safe_dump(tree.plain(), sort_keys=False, allow_unicode=True)


def _read_with_bases(path: Path, seen: tuple[Path, ...] = ()) -> tuple[str, YamlNode, bool]:
    """Text and tree of a file, what it extends merged in, and whether it extends anything."""
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
            find_cell(beside)  # says what there is beside the file
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


def _validated(tree: YamlNode) -> CellDescription:
    try:
        # as JSON, because strict validation takes JSON's lists for tuples but no text for numbers
        return CellDescription.model_validate_json(json.dumps(tree.plain()), strict=True)
    except ValidationError as error:
        raise CellError([problem_of(tree, dict(item), CellDescription) for item in error.errors()]) from None
