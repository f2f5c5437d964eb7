"""YAML as a tree in which every value knows the file and line that it came from."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, TypeAlias

from deltaq_cell.models import nearest_name
from deltaq_cell.problems import CellError, Problem

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


def shown(value: object) -> Scalar:
    """A value as a message and JSON can carry it."""
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."
