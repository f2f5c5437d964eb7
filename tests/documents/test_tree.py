"""The tree holds together: one name for a type, code beside equations of the documents, no shared random numbers."""

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
USERS = "protocol/deltaq"
"""What users import: short names, the same for scripts and for asyncio, as the names of what they stand for."""


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


@pytest.mark.long
def test_every_public_type_name_is_unique() -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        if package == USERS:
            continue
        for path in sorted((ROOT / package).rglob("*.py")):
            for name in public_types(path.read_text(encoding="utf-8")):
                found[name].append(str(path.relative_to(ROOT)))
    assert len(found) > 300
    assert {name: paths for name, paths in found.items() if len(paths) > 1} == {}


CAMERA = ROOT / "controllers/deltaq_controllers/camera"
PAGE = (ROOT / "docs/explanation/camera-follower.md").read_text(encoding="utf-8")
SOURCES = {
    path.name: path.read_text(encoding="utf-8")
    for path in (
        *(CAMERA / "escape").glob("*.py"),
        *CAMERA.parent.glob("*.py"),
        *CAMERA.glob("*.py"),
        *(CAMERA.parent / "surroundings").glob("*.py"),
    )
}


def code_of_tables() -> Iterator[str]:
    """What stands in code style in the last column of a table that calls this column code."""
    is_code = False
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in line.strip("|").replace(r"\|", "").split("|")]
        if not line.startswith("|"):
            is_code = False
        elif cells[-1].startswith("code"):
            is_code = True
        elif is_code:
            yield from re.findall(r"`([^`]+)`", cells[-1])


NAMES = sorted(set(code_of_tables()))


def test_there_are_tables_of_equations_and_code() -> None:
    assert len(NAMES) > 15


@pytest.mark.parametrize("name", NAMES)
def test_code_named_beside_an_equation_exists(name: str) -> None:
    if name.endswith(".py"):
        assert name in SOURCES
        return
    module, _, attribute = name.rpartition(".")
    for part in re.findall(r"\w+", attribute):
        defined = re.compile(
            rf"^\s*(def|class) {part}\b|\b{part}\b\s*[:=]|\b{part}, |, {part}\b", re.MULTILINE
        )
        sources = [SOURCES[f"{module}.py"]] if module else list(SOURCES.values())
        assert any(defined.search(source) for source in sources), f"{part} of {name}"


TESTS = ROOT / "tests"
GENERATORS = ("default_rng", "Generator", "Random", "RandomState")


def shared_generators(text: str) -> list[int]:
    """Lines at which a module keeps a generator of random numbers for all its tests."""
    kept = [node for node in ast.parse(text).body if isinstance(node, ast.Assign | ast.AnnAssign)]
    return [
        node.lineno
        for node in kept
        if isinstance(node.value, ast.Call) and ast.unparse(node.value.func).endswith(GENERATORS)
    ]


@pytest.mark.long
def test_no_test_module_shares_a_random_generator() -> None:
    found = {path: shared_generators(path.read_text(encoding="utf-8")) for path in TESTS.rglob("*.py")}
    assert {path: lines for path, lines in found.items() if lines} == {}
