"""A YAML text as a tree of located values: libyaml's events, composed under bounds of size and depth.

libyaml reads fifteen times faster than Python does, which every start of a process has to wait for. Of YAML it is the
syntax; what a plain word means is decided here, by the core schema of YAML 1.2 (10.3.2): `no` is a text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from deltaq_cell.problems import CellError, Problem
from deltaq_cell.yaml_source import Scalar, YamlNode

MAX_BYTES = 1 << 20
MAX_NODES = 20_000
MAX_DEPTH = 24

# PyYAML's own parser says the same where it was installed without libyaml
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_TAG = "tag:yaml.org,2002:"
_NULL = re.compile(r"(?:~|null|Null|NULL|)")
_TRUE = re.compile(r"(?:true|True|TRUE)")
_FALSE = re.compile(r"(?:false|False|FALSE)")
_DECIMAL = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"[-+]?\.(?:inf|Inf|INF)")
_NOT_A_NUMBER = re.compile(r"\.(?:nan|NaN|NAN)")
_MOST_DIGITS = 400
"""Of a number; Python refuses to read much longer ones."""


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
        return _Composer(file).document(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise _error(file, mark.line + 1 if mark else 0, f"not YAML: {error.problem or error}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise _error(file, 0, f"not YAML: {str(error).splitlines()[0]}") from None


@dataclass
class _Open:
    """A mapping or list whose end has not come."""

    line: int
    is_map: bool
    anchor: str | None
    children: dict[str, YamlNode] = field(default_factory=dict)
    items: list[YamlNode] = field(default_factory=list)
    merged: dict[str, YamlNode] = field(default_factory=dict)
    key: YamlNode | None = None
    nodes: int = 1
    depth: int = 0
    """Of what is below it."""

    def node(self, file: str) -> YamlNode:
        value = {**self.merged, **self.children} if self.is_map else self.items
        return YamlNode(value, file, self.line)


@dataclass(frozen=True)
class _Anchored:
    node: YamlNode
    nodes: int
    depth: int


class _Composer:
    """Composes nodes from events, and counts them, because aliases can make a small file a giant tree."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._open: list[_Open] = []
        self._anchors: dict[str, _Anchored | None] = {}
        self._root: YamlNode | None = None

    def document(self, text: str) -> YamlNode:
        """The tree of the only document, with null for none."""
        documents = 0
        for event in yaml.parse(text, Loader=_Loader):
            line = event.start_mark.line + 1 if event.start_mark is not None else 0
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise _error(
                        self._file, line, "not YAML: expected a single document, and here begins another"
                    )
            elif isinstance(event, yaml.ScalarEvent):
                node = YamlNode(self._scalar(event, line), self._file, line)
                self._remember(event.anchor, _Anchored(node, 1, 0))
                self._add(node, 1, 0)
            elif isinstance(event, yaml.AliasEvent):
                self._alias(event.anchor, line)
            elif isinstance(event, yaml.CollectionStartEvent):
                self._begin(event, line)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._end()
        return self._root or YamlNode(None, self._file, 0)

    def _begin(self, event: yaml.CollectionStartEvent, line: int) -> None:
        is_map = isinstance(event, yaml.MappingStartEvent)
        self._check_tag(event.tag, line, "map" if is_map else "seq")
        if self._open and self._open[-1].is_map and self._open[-1].key is None:
            raise _error(self._file, line, "not YAML: a list or a mapping cannot be a key here")
        if event.anchor is not None:
            self._anchors[event.anchor] = None  # until its end has come
        self._open.append(_Open(line, is_map, event.anchor))
        self._bound(line)

    def _end(self) -> None:
        ended = self._open.pop()
        node = ended.node(self._file)
        self._remember(ended.anchor, _Anchored(node, ended.nodes, ended.depth))
        self._add(node, ended.nodes, ended.depth)

    def _alias(self, anchor: str | None, line: int) -> None:
        if anchor is None or anchor not in self._anchors:
            raise _error(self._file, line, f"not YAML: found undefined alias '{anchor}'")
        anchored = self._anchors[anchor]
        if anchored is None:
            raise _error(self._file, line, f"the value of alias '{anchor}' would contain itself")
        self._add(YamlNode(anchored.node.value, self._file, line), anchored.nodes, anchored.depth)

    def _remember(self, anchor: str | None, anchored: _Anchored) -> None:
        if anchor is not None:
            self._anchors[anchor] = anchored

    def _add(self, node: YamlNode, nodes: int, depth: int) -> None:
        """Put a finished node where it belongs: the root, an item, a key or its value."""
        if not self._open:
            self._root = node
            return
        above = self._open[-1]
        above.nodes += nodes
        above.depth = max(above.depth, depth + 1)
        self._bound(node.line)
        if not above.is_map:
            above.items.append(node)
        elif above.key is None:
            above.key = node
        else:
            key, above.key = above.key, None
            self._put(above, key, node)

    def _put(self, above: _Open, key: YamlNode, node: YamlNode) -> None:
        if key.value == "<<":
            self._merge(above, node)
            return
        if not isinstance(key.value, str):
            message = f"the key {key.value!r} must be text; put it in quotes"
            raise _error(self._file, key.line, message, value=str(key.value))
        if key.value in above.children:
            message = f"the key '{key.value}' is there twice; keep one of them"
            raise _error(self._file, key.line, message, value=key.value)
        # a value is where its key is, also one that begins on the next line
        above.children[key.value] = YamlNode(node.value, self._file, key.line)

    def _merge(self, above: _Open, node: YamlNode) -> None:
        """`<<`: what the mapping does not say itself, it takes from these, of several from the first."""
        for source in node.value if isinstance(node.value, list) else [node]:
            if not isinstance(source.value, dict):
                raise _error(
                    self._file, node.line, "'<<' merges a mapping or a list of mappings, and nothing else"
                )
            for name, child in source.value.items():
                above.merged.setdefault(name, YamlNode(child.value, self._file, node.line))

    def _bound(self, line: int) -> None:
        nodes = sum(level.nodes for level in self._open)
        deepest = self._open[-1].depth + len(self._open) - 1
        if nodes > MAX_NODES or deepest > MAX_DEPTH:
            message = (
                f"has more than {MAX_NODES} values or is nested deeper than {MAX_DEPTH}; look at its aliases"
            )
            raise _error(self._file, line, message, bound=MAX_NODES if nodes > MAX_NODES else MAX_DEPTH)

    def _scalar(self, event: yaml.ScalarEvent, line: int) -> Scalar:
        if event.tag is None and event.implicit[0]:
            return _plain(event.value)
        kind = self._check_tag(event.tag, line, "str", "int", "float", "bool", "null")
        value = event.value if kind == "str" else _plain(event.value)
        return float(value) if kind == "float" and isinstance(value, int) else value

    def _check_tag(self, tag: str | None, line: int, *allowed: str) -> str:
        kind = allowed[0] if tag in (None, "!") else str(tag).removeprefix(_TAG)
        if kind not in allowed:
            raise _error(self._file, line, f"the tag {tag} means nothing here; leave it out", value=str(tag))
        return kind


def _plain(text: str) -> Scalar:
    """The value of a word without quotes."""
    if _NULL.fullmatch(text):
        return None
    if _TRUE.fullmatch(text) or _FALSE.fullmatch(text):
        return text[0] in "tT"
    if len(text) > _MOST_DIGITS:
        return text
    if _DECIMAL.fullmatch(text):
        return int(text)
    if _OCTAL.fullmatch(text) or _HEXADECIMAL.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITY.fullmatch(text) or _NOT_A_NUMBER.fullmatch(text):
        return float(text.replace(".", ""))
    return text


def _error(
    file: str, line: int, message: str, value: Scalar = None, bound: str | int | float | None = None
) -> CellError:
    return CellError([Problem(file, line, "", message, value=value, bound=bound)])
