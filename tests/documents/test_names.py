"""A name of a type stands for one thing in the whole tree, so that a reader who has met it once knows it everywhere."""

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"][
    "targets"
]["wheel"]["packages"]


def public_types(text: str) -> Iterator[str]:
    """Names of the public classes of a module, nested ones included, and of its public aliases of types."""
    module = ast.parse(text)
    names = [node.name for node in ast.walk(module) if isinstance(node, ast.ClassDef)]
    for node in module.body:
        if isinstance(node, ast.Assign) and not _is_type_variable(node.value):
            names += [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.append(node.target.id)
    return (name for name in names if re.match(r"[A-Z]\w*[a-z]", name))


def _is_type_variable(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and ast.unparse(value.func) == "TypeVar"


def test_types_are_found_however_they_are_made() -> None:
    text = "class One:\n    class Two: ...\n\nThree = int | str\nFour: TypeAlias = int\nM = TypeVar('M')\nBOUND = 5"
    assert sorted(public_types(text)) == ["Four", "One", "Three", "Two"]
    assert list(public_types("class _Private: ...")) == []


@pytest.mark.long
def test_no_public_name_of_a_type_stands_twice_in_the_tree() -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for name in public_types(path.read_text(encoding="utf-8")):
                found[name].append(str(path.relative_to(ROOT)))
    assert len(found) > 300
    assert {name: paths for name, paths in found.items() if len(paths) > 1} == {}
