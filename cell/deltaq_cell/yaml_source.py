"""YAML as a tree in which every value knows the file and line that it came from."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from deltaq_cell.models import nearest_name
from deltaq_cell.problems import CellError, Problem

MAX_BYTES = 1 << 20
MAX_NODES = 20_000
MAX_DEPTH = 24

Scalar: TypeAlias = str | int | float | bool | None
Content: TypeAlias = "Scalar | dict[str, YamlNode] | list[YamlNode]"


@dataclass(frozen=True)
class YamlNode:
    """A value of a YAML file: a scalar, or a mapping or list of located values."""

    value: Content
    file: str
    line: int

    def plain(self) -> Any:
        """The value without its places."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain() for child in self.value]
        return self.value

    def find(self, path: tuple[str | int, ...]) -> tuple[YamlNode, tuple[str | int, ...]]:
        """The deepest value on a path, and the part of the path that leads to it.

        Parts of the path that the tree does not have are passed over: a validator names the branch of a
        union that it took, and fields that are missing.
        """
        node, trail = self, []
        for part in path:
            if isinstance(node.value, dict) and part in node.value:
                node = node.value[str(part)]
            elif isinstance(node.value, list) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
            else:
                continue
            trail.append(part)
        return node, tuple(trail)


def merge(base: YamlNode, over: YamlNode, removable: Collection[str] = ()) -> YamlNode:
    """Deep merge: mappings are merged key by key, anything else of `over` takes the place of `base`.

    Args:
        base: what is changed.
        over: the changes.
        removable: keys of `base` below which null removes the entry of that name.

    Raises:
        CellError: there is no entry of the name that null should remove.
    """
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    merged = dict(base.value)
    for key, child in over.value.items():
        if key in removable and isinstance(child.value, dict):
            merged[key], child = _without(key, merged.get(key), child)
        merged[key] = merge(merged[key], child) if key in merged else child
    return YamlNode(merged, over.file, over.line)


def _without(section: str, base: YamlNode | None, over: YamlNode) -> tuple[YamlNode, YamlNode]:
    """A section without the entries that are null in its changes, and the changes without those nulls."""
    assert isinstance(over.value, dict)  # the caller ensures it
    had = base.value if base is not None and isinstance(base.value, dict) else {}
    gone = {key: child for key, child in over.value.items() if child.value is None}
    for key, child in gone.items():
        if key not in had:
            near = nearest_name(key, had)
            message = f"nothing of that name to take out; there is {', '.join(had) or 'nothing'}"
            message += f"; did you mean '{near}'?" if near else ""
            field = f"{section}.{key}"
            raise CellError([Problem(child.file, child.line, field, message, suggestion=near)])
    kept = {key: child for key, child in had.items() if key not in gone}
    changes = {key: child for key, child in over.value.items() if key not in gone}
    place = over if base is None else base
    return YamlNode(kept, place.file, place.line), YamlNode(changes, over.file, over.line)


def read(path: Path) -> tuple[str, YamlNode]:
    """Read one YAML file: its text and its tree, whose root is a mapping.

    Raises:
        CellError: it cannot be read, is too large, is no YAML, has a key twice, or is no mapping.
    """
    file = path.name
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise _error(file, 0, f"cannot be read: {error.strerror or error}") from None
    if len(data) > MAX_BYTES:
        raise _error(
            file, 0, f"is too large for a cell description: more than {MAX_BYTES} bytes", bound=MAX_BYTES
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise _error(file, line, "is not UTF-8 text; save it as UTF-8") from None
    return text, parse(text, file)


def parse(text: str, file: str) -> YamlNode:
    """The tree of a YAML text; `file` is its name in messages.

    Raises:
        CellError: it is no YAML, has a key twice, or is no mapping.
    """
    try:
        root = YAML(typ="rt").load(text)
    except DuplicateKeyError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        what = str(error.problem).split(" with value")[0].removeprefix("found duplicate key ").strip("\"'")
        raise _error(file, line, f"the key '{what}' is there twice; keep one of them", value=what) from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise _error(file, mark.line + 1 if mark else 0, f"not YAML: {error.problem or error}") from None
    except KeyError as error:  # ruamel looks up the version of a %YAML directive
        raise _error(file, 1, f"not YAML: no version {error} of it is known; use 1.2") from None
    except (YAMLError, ValueError, TypeError, RecursionError) as error:  # TypeError: a list or a map as a key
        raise _error(
            file, 0, f"not YAML: {str(error).splitlines()[0] if str(error) else 'too deep'}"
        ) from None
    if root is None:
        raise _error(file, 0, "is empty; a cell needs at least the fields cell, cycle_s and robots")
    if not isinstance(root, CommentedMap):
        raise _error(
            file, 1, f"must be a mapping with the fields cell, cycle_s and robots, not a {_kind(root)}"
        )
    return _Tree(file).build(root, 1, 0)


class _Tree:
    """Builds located values; counts them, because aliases can make a small file a giant tree."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.nodes = 0

    def build(self, raw: object, line: int, depth: int) -> YamlNode:
        self.nodes += 1
        if self.nodes > MAX_NODES or depth > MAX_DEPTH:
            raise _error(
                self.file,
                line,
                f"has more than {MAX_NODES} values or is nested deeper than {MAX_DEPTH}; look at its aliases",
                bound=MAX_NODES if depth <= MAX_DEPTH else MAX_DEPTH,
            )
        if isinstance(raw, CommentedMap):
            children = {}
            for key, child in raw.items():
                at = raw.lc.data[key][0] + 1 if key in raw.lc.data else line  # merged keys have no place
                if not isinstance(key, str):
                    raise _error(
                        self.file, at, f"the key {key!r} must be text; put it in quotes", value=str(key)
                    )
                children[str(key)] = self.build(child, at, depth + 1)
            return YamlNode(children, self.file, line)
        if isinstance(raw, CommentedSeq):
            places = raw.lc.data or {}
            items = [
                self.build(child, places[i][0] + 1 if i in places else line, depth + 1)
                for i, child in enumerate(raw)
            ]
            return YamlNode(items, self.file, line)
        return YamlNode(_scalar(raw), self.file, line)


def _scalar(raw: object) -> Scalar:
    # ruamel's own scalars remember how they were written; take the plain value
    if raw is None or isinstance(raw, bool):
        return raw
    if isinstance(raw, int):
        return int(raw)
    if isinstance(raw, float):
        return float(raw)
    return str(raw)


def _kind(raw: object) -> str:
    return "list" if isinstance(raw, CommentedSeq) else "single value"


def shown(value: object) -> Scalar:
    """A value as a message and JSON can carry it."""
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _error(
    file: str, line: int, message: str, value: Scalar = None, bound: str | int | float | None = None
) -> CellError:
    return CellError([Problem(file, line, "", message, value=value, bound=bound)])
