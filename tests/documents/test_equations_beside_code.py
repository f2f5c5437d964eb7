"""The explanation of the camera's laws sets equations beside code: the code has to be there."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
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
def test_code_that_stands_beside_an_equation_exists(name: str) -> None:
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
