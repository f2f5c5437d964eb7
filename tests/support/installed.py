"""deltaq as a user has it: a wheel in an environment of its own, beside nothing that it did not ask for.

Third-party packages are not downloaded again: those that the wheel asks for are linked, file by file, from the
environment that runs the tests. pip then installs the wheel with `--no-index`, and refuses if one is missing.
"""

import importlib
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import Distribution, distribution
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from deltaq_cell import machine_code

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Installed:
    """An environment with deltaq in it."""

    folder: Path

    @property
    def bin(self) -> Path:
        return self.folder / "bin"

    @property
    def packages(self) -> Path:
        return Path(sysconfig.get_path("purelib", vars={"base": str(self.folder)}))

    def environment(self, **more: str) -> dict[str, str]:
        """Environment variables with which its programs come first, and nothing of the tree is seen."""
        kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        path = f"{self.bin}{os.pathsep}{os.environ['PATH']}"
        return {**kept, "PATH": path, "VIRTUAL_ENV": str(self.folder), **more}

    def add(self, package: str) -> None:
        """Install another package beside it, as pip would."""
        _link(distribution(package), self.packages)

    def take_machine_code(self) -> None:
        """Leave beside its code what the tree has compiled of the same sources, as an earlier start would."""
        for name in ("deltaq_cell", "deltaq_controllers"):
            (package,) = map(Path, importlib.import_module(name).__path__)
            kept = Path(machine_code.folder(package))
            shutil.copytree(kept, self.packages / name / "__pycache__" / kept.name, dirs_exist_ok=True)

    def run(self, *words: str, **more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(self.bin / words[0]), *words[1:]],
            env=self.environment(**more),
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )


def build_wheel(folder: Path) -> Path:
    """Build the tree's wheel, as a release does."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(wheel: Path, folder: Path, extra: str = "") -> Installed:
    """Make an environment and let pip install the wheel into it, with an extra or bare."""
    venv.create(folder, with_pip=False, symlinks=True)
    installed = Installed(folder)
    for package in _asked_for(wheel, extra):
        _link(package, installed.packages)
    command = [sys.executable, "-m", "pip", "--python", str(installed.bin / "python"), "install", "--quiet"]
    offline = ["--no-index", "--disable-pip-version-check", "-c", str(ROOT / "constraints.txt")]
    subprocess.run(
        [*command, *offline, f"{wheel}[{extra}]" if extra else str(wheel)],
        check=True,
        timeout=300,
        env=installed.environment(),
    )
    return installed


def _asked_for(wheel: Path, extra: str) -> Iterable[Distribution]:
    """The distributions that a wheel asks for, and those that they ask for."""
    with ZipFile(wheel) as archive:
        (metadata,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        lines = archive.read(metadata).decode().splitlines()
    own = [line.removeprefix("Requires-Dist: ") for line in lines if line.startswith("Requires-Dist: ")]
    found: dict[str, Distribution] = {}
    visited: set[tuple[str, str]] = {("deltaq", extra)}
    waiting = [(extra, own)]
    while waiting:
        wanted, requirements = waiting.pop()
        for requirement in map(Requirement, requirements):
            if requirement.marker is not None and not requirement.marker.evaluate({"extra": wanted}):
                continue
            needed = canonicalize_name(requirement.name)
            if needed != "deltaq":
                found[needed] = distribution(needed)
            for its in ["", *sorted(requirement.extras)]:
                if (needed, its) not in visited:
                    visited.add((needed, its))
                    more = own if needed == "deltaq" else found[needed].requires or []
                    waiting.append((its, more))
    return found.values()


def _link(package: Distribution, packages: Path) -> None:
    for file in package.files or ():
        source = Path(str(package.locate_file(file)))
        target = packages / file
        if ".." in file.parts or not source.exists() or target.exists():
            continue  # a script, bytecode that has gone since, or what is there from before
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(source.resolve())


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this tree, built once."""
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """What `pip install deltaq` gives."""
    return install(wheel, tmp_path_factory.mktemp("bare") / "venv")


@pytest.fixture(scope="session")
def complete(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """What `pip install 'deltaq[all]'` gives."""
    return install(wheel, tmp_path_factory.mktemp("all") / "venv", "all")
