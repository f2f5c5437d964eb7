"""What is passed on: the source archive makes the same wheel as the tree, and is all that one needs to work on it."""

import re
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest
from installed import ROOT
from ran import ran

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NEEDED = {
    "LICENSE",
    "Makefile",
    "constraints.txt",
    "mkdocs.yml",
    "docs/index.md",
    "docs/images/console.png",
    "examples/with_asyncio.py",
    "clients/matlab/+deltaq/Client.m",
    "tests/conftest.py",
    "tests/deploy/test_releases.py",
    ".github/workflows/test.yml",
}
REGISTRIES = re.compile(r"\b(pypi|pythonhosted|npmjs|unpkg|ghcr|docker|quay)\.(org|com|io)\b")


def build(kind: str, source: Path, folder: Path) -> Path:
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=300)
    (made,) = folder.iterdir()
    return made


def contents(wheel: Path) -> dict[str, bytes]:
    with ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source archive, unpacked."""
    folder = tmp_path_factory.mktemp("source")
    with tarfile.open(build("sdist", ROOT, tmp_path_factory.mktemp("sdist"))) as archive:
        archive.extractall(folder, filter="data")
    (tree,) = folder.iterdir()
    assert tree.name == f"deltaq-{PROJECT['version']}"
    return tree


@pytest.mark.nightly
def test_the_source_archive_makes_the_same_wheel_as_the_tree(
    unpacked: Path, wheel: Path, tmp_path: Path
) -> None:
    again = build("wheel", unpacked, tmp_path)
    assert again.name == wheel.name
    one, other = contents(again), contents(wheel)
    assert sorted(one) == sorted(other)
    assert [name for name in one if one[name] != other[name]] == []


@pytest.mark.nightly
def test_the_source_archive_contains_the_tree_and_no_build_products(unpacked: Path) -> None:
    files = {str(file.relative_to(unpacked)) for file in unpacked.rglob("*") if file.is_file()}
    assert NEEDED - files == set()
    made = {
        ".venv",
        "build",
        "dist",
        "__pycache__",
        ".mypy_cache",
        ".ruff_cache",
        ".pytest_cache",
        "out",
        ".git",
    }
    assert [file for file in files if made & set(Path(file).parts)] == []


@pytest.mark.long
def test_no_file_names_a_package_registry() -> None:
    listed = ran(["git", "ls-files", "-z"], cwd=ROOT, check=False)
    if listed.returncode:
        pytest.skip("no clone: which files are the project's is not known")
    names = listed.stdout.split("\0")[:-1]
    assert len(names) > 900
    texts = ((name, (ROOT / name).read_text(encoding="utf-8", errors="replace")) for name in names)
    assert [(name, found[0]) for name, text in texts if (found := REGISTRIES.search(text))] == []
