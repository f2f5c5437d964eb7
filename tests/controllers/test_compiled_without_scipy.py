"""Compiled functions use no linear algebra of numba's: it needs scipy, which an installed deltaq does not have."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
DECORATORS = {"compiled", "inlined", "makes_no_array"}
LINEAR_ALGEBRA = {"dot", "vdot", "linalg"}


def compiled_functions() -> Iterator[Any]:
    for folder in ("cell/deltaq_cell", "controllers/deltaq_controllers", "services/deltaq_services"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            source = file.read_text(encoding="utf-8")
            if not any(f"@{name}\n" in source for name in DECORATORS):
                continue  # to parse the whole tree takes seconds
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.FunctionDef) and any(
                    isinstance(one, ast.Name) and one.id in DECORATORS for one in node.decorator_list
                ):
                    yield pytest.param(node, id=f"{file.stem}.{node.name}")


def needs_scipy(function: ast.AST) -> list[int]:
    return [
        node.lineno
        for node in ast.walk(function)
        if (isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in LINEAR_ALGEBRA)
    ]


@pytest.mark.parametrize("function", list(compiled_functions()))
def test_a_compiled_function_uses_no_linear_algebra_of_numba(function: ast.FunctionDef) -> None:
    assert needs_scipy(function) == []


@pytest.mark.parametrize("line", ["a @ b", "np.dot(a, b)", "a.dot(b)", "np.linalg.norm(a)"])
def test_linear_algebra_is_seen(line: str) -> None:
    assert needs_scipy(ast.parse(f"def f(a, b):\n    return {line}")) == [2]
