"""Problems of a cell, each at the place in its file that it is about."""

from __future__ import annotations

from deltaq_cell.problems import Problem
from deltaq_cell.yaml_source import YamlNode, shown
from deltaq_protocol.errors import Severity

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
