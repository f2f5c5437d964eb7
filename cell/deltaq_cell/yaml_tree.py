"""A YAML text as a tree in which every value knows the file and line that it came from.

PyYAML composes the nodes, in C where libyaml is there, which every start of a process has to wait for. What a plain
word means is decided here, by the core schema of YAML 1.2 (10.3.2): `no` is a text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import yaml

from deltaq_cell.models import nearest_name
from deltaq_cell.problems import CellError, Problem
from deltaq_protocol.errors import Severity

MAX_BYTES = 1 << 20
MAX_NODES = 20_000
MAX_DEPTH = 24

_TAG = "tag:yaml.org,2002:"
_MOST_DIGITS = 400
"""Of a number; Python refuses to read much longer ones."""
_WORDS = {
    kind: re.compile(rf"(?=.{{0,{_MOST_DIGITS}}}\Z)(?:{words})\Z")
    for kind, words in {
        "null": r"~|null|Null|NULL|",
        "bool": r"true|True|TRUE|false|False|FALSE",
        "int": r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
        "float": r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
    }.items()
}


class _CoreSchema(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc] # found at runtime
    """Takes plain words as the core schema has them."""

    yaml_implicit_resolvers: ClassVar[dict[str | None, list[tuple[str, re.Pattern[str]]]]] = {
        None: [(_TAG + kind, words) for kind, words in _WORDS.items()]
    }


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
        base: the tree that is changed.
        over: the changes.
        removable: keys at any depth below which null removes the entry of that name.

    Raises:
        CellError: there is no entry of the name that null should remove.
    """
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    merged = dict(base.value)
    for key, child in over.value.items():
        if key in removable and isinstance(child.value, dict):
            merged[key], child = _without(key, merged.get(key), child)
        merged[key] = merge(merged[key], child, removable) if key in merged else child
    return YamlNode(merged, over.file, over.line)


def _without(section: str, base: YamlNode | None, over: YamlNode) -> tuple[YamlNode, YamlNode]:
    """A section without the entries that are null in its changes, and the changes without those nulls."""
    assert isinstance(over.value, dict)  # the caller ensures it
    had = base.value if base is not None and isinstance(base.value, dict) else {}
    gone = {key: child for key, child in over.value.items() if child.value is None}
    for key, child in gone.items():
        if key not in had:
            near = nearest_name(key, had)
            message = f"nothing of that name to remove; there is {', '.join(had) or 'nothing'}"
            message += f"; did you mean '{near}'?" if near else ""
            field = f"{section}.{key}"
            raise CellError([Problem(child.file, child.line, field, message, suggestion=near)])
    kept = {key: child for key, child in had.items() if key not in gone}
    changes = {key: child for key, child in over.value.items() if key not in gone}
    place = over if base is None else base
    return YamlNode(kept, place.file, place.line), YamlNode(changes, over.file, over.line)


def shown(value: object) -> Scalar:
    """A value in a form that messages and JSON can carry."""
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."


FieldPath = tuple[str | int, ...]


class PlacedProblems:
    """Makes problems of a cell.

    Args:
        tree: the cell's file.
    """

    def __init__(self, tree: YamlNode) -> None:
        self._tree = tree

    def at(
        self,
        field: FieldPath,
        message: str,
        value: object = None,
        bound: str | int | float | None = None,
        suggestion: str | None = None,
        severity: Severity = "error",
    ) -> Problem:
        """A problem at the place of a field."""
        node, _ = self._tree.find(field)
        name = ".".join(str(part) for part in field)
        return Problem(node.file, node.line, name, message, shown(value), bound, suggestion, severity)


def read(path: Path) -> tuple[str, YamlNode]:
    """Read the YAML file of a cell: its text and its tree, whose root is a mapping.

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
    return text, cell_tree(text, file)


def cell_tree(text: str, file: str) -> YamlNode:
    """The tree of a cell's YAML text, whose root is a mapping; `file` is its name in messages.

    Raises:
        CellError: it is no YAML, has a key twice, or is no mapping.
    """
    root = parse(text, file)
    if root.value is None:
        raise _error(file, 0, "is empty; a cell needs at least the fields cell, cycle_s and robots")
    if not isinstance(root.value, dict):
        kind = "list" if isinstance(root.value, list) else "single value"
        raise _error(file, 1, f"must be a mapping with the fields cell, cycle_s and robots, not a {kind}")
    return root


def parse(text: str, file: str) -> YamlNode:
    """The tree of a YAML text of one document; `file` is its name in messages.

    Raises:
        CellError: it is no YAML, is too large or too deep, or has a key twice or one that is no text.
    """
    try:
        _check_nesting(text, file)
        root = yaml.compose(text, Loader=_CoreSchema)
    except yaml.MarkedYAMLError as error:
        raise _not_yaml(error, text, file) from None
    except (yaml.YAMLError, ValueError) as error:
        raise _error(file, 0, f"not YAML: {str(error).splitlines()[0]}") from None
    return YamlNode(None, file, 0) if root is None else _Located(file).node(root, _line(root))


def _check_nesting(text: str, file: str) -> None:
    """Refuse text that is nested so deeply that PyYAML would overflow the stack or misread it."""
    around: list[str | None] = []
    anchors: set[str] = set()
    for event in yaml.parse(text, Loader=_CoreSchema):
        anchor = event.anchor if isinstance(event, yaml.NodeEvent) else None
        if isinstance(event, yaml.AliasEvent):
            if anchor in around:
                raise _error(file, _line(event), f"the value of alias '{anchor}' would contain itself")
        elif anchor is not None:
            if anchor in anchors:
                message = f"the anchor '{anchor}' is there twice; give one of them another name"
                raise _error(file, _line(event), message)
            anchors.add(anchor)
        if isinstance(event, yaml.CollectionStartEvent):
            around.append(anchor)
            if len(around) > MAX_DEPTH:
                raise _too_large(file, _line(event), MAX_DEPTH)
        elif isinstance(event, yaml.CollectionEndEvent):
            around.pop()


def _not_yaml(error: yaml.MarkedYAMLError, text: str, file: str) -> CellError:
    """What PyYAML says, at the line that it says it of."""
    mark = error.problem_mark or error.context_mark
    problem = str(error.problem or error)
    if problem.startswith("but "):
        problem = f"{error.context}, {problem}"
    elif problem.startswith("found undefined alias") and mark is not None:
        alias = re.match(r"\*([^\s,\[\]{}]*)", text.splitlines()[mark.line][mark.column :])
        problem = f"found undefined alias '{alias[1]}'" if alias else problem
    return _error(file, mark.line + 1 if mark else 0, f"not YAML: {problem}")


class _Located:
    """Makes located values of PyYAML's nodes, and counts them, since aliases can make a small file a giant tree."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._count = self._depth = self._reached = 0

    def node(self, node: yaml.Node, line: int) -> YamlNode:
        """The value of a node, which stands at a line."""
        self._count += 1
        self._reached = max(self._reached, line)
        if self._count > MAX_NODES:
            raise _too_large(self._file, self._reached, MAX_NODES)
        if isinstance(node, yaml.ScalarNode):
            return YamlNode(self._scalar(node), self._file, line)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise _too_large(self._file, self._reached, MAX_DEPTH)
        value: Content
        if isinstance(node, yaml.MappingNode):
            self._kind(node, "map")
            value = self._mapping(node)
        else:
            self._kind(node, "seq")
            value = [self.node(item, _line(item)) for item in node.value]
        self._depth -= 1
        return YamlNode(value, self._file, line)

    def _mapping(self, node: yaml.MappingNode) -> dict[str, YamlNode]:
        own: dict[str, YamlNode] = {}
        merged: dict[str, YamlNode] = {}
        for key, value in node.value:
            line = _line(key)
            if not isinstance(key, yaml.ScalarNode):
                raise _error(self._file, line, "not YAML: a list or a mapping cannot be a key here")
            name = self._scalar(key)
            if name == "<<":
                self._merge(merged, value, line)
            elif not isinstance(name, str):
                message = f"the key {name!r} must be text; put it in quotes"
                raise _error(self._file, line, message, value=str(name))
            elif name in own:
                message = f"the key '{name}' is there twice; keep one of them"
                raise _error(self._file, line, message, value=name)
            else:
                # a value is where its key is, also one that begins on the next line
                own[name] = self.node(value, line)
        return {**merged, **own}

    def _merge(self, merged: dict[str, YamlNode], value: yaml.Node, line: int) -> None:
        """`<<`: add the keys that the mapping does not have; of several sources the first one counts."""
        for source in value.value if isinstance(value, yaml.SequenceNode) else [value]:
            if not isinstance(source, yaml.MappingNode):
                raise _error(
                    self._file, line, "'<<' merges a mapping or a list of mappings, and nothing else"
                )
            children = self.node(source, line).value
            assert isinstance(children, dict)  # as that of a mapping is
            for name, child in children.items():
                merged.setdefault(name, YamlNode(child.value, self._file, line))

    def _scalar(self, node: yaml.ScalarNode) -> Scalar:
        kind, text = self._kind(node, "str", *_WORDS), str(node.value)
        if kind == "str" or not _WORDS[kind].match(text):
            return text
        if kind == "null":
            return None
        if kind == "bool":
            return text[0] in "tT"
        if kind == "int":
            return int(text, 0 if text[:2] in ("0o", "0x") else 10)
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))

    def _kind(self, node: yaml.Node, *allowed: str) -> str:
        kind = str(node.tag).removeprefix(_TAG)
        if kind not in allowed:
            message = f"the tag {node.tag} is not supported here; remove it"
            raise _error(self._file, _line(node), message, value=str(node.tag))
        return kind


def _line(begun: yaml.Node | yaml.Event) -> int:
    return begun.start_mark.line + 1 if begun.start_mark is not None else 0


def _too_large(file: str, line: int, bound: int) -> CellError:
    message = f"has more than {MAX_NODES} values or is nested deeper than {MAX_DEPTH}; look at its aliases"
    return _error(file, line, message, bound=bound)


def _error(
    file: str, line: int, message: str, value: Scalar = None, bound: str | int | float | None = None
) -> CellError:
    return CellError([Problem(file, line, "", message, value=value, bound=bound)])
