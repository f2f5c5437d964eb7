"""A wheel in an environment of its own: what each extra gives, and what the command says where something is missing."""

import re
import sys
import tomllib
from pathlib import Path

import pytest
from installed import ROOT, Installed, install
from ran import ran

pytestmark = pytest.mark.long

HEAVY = {"typer", "rich", "pinocchio", "coal", "numba", "yaml", "matplotlib", "mcap"}
INSTALL_PAGE = ROOT / "docs" / "how-to" / "install.md"


def missing(installed: Installed) -> set[str]:
    """Which of the heavy modules an environment does not have."""
    code = (
        "import importlib\n"
        f"for name in {sorted(HEAVY)!r}:\n"
        "    try: importlib.import_module(name)\n"
        "    except ModuleNotFoundError: print(name)\n"
    )
    done = installed.run("python", "-c", code)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.nightly
def test_a_bare_install_contains_the_complete_client_and_nothing_else(bare: Installed) -> None:
    assert missing(bare) == HEAVY
    code = "from deltaq_protocol import connect, blocking; import deltaq_protocol as p; print(p.__file__)"
    done = bare.run("python", "-c", code)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(bare.packages)


@pytest.mark.nightly
@pytest.mark.parametrize("words", [(), ("--help",), ("status",), ("up", "--cell", "lab")], ids=" ".join)
def test_the_command_of_a_bare_install_names_the_extra_to_install(
    bare: Installed, words: tuple[str, ...]
) -> None:
    done = bare.run("deltaq", *words)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("deltaq: typer is not installed")
    assert "pip install 'deltaq[all]'" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.nightly
def test_a_complete_install_lacks_nothing_and_checks_a_cell(complete: Installed) -> None:
    assert missing(complete) == set()
    done = complete.run("deltaq", "check", "--cell", "lab")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("lab: good\n")


@pytest.mark.nightly
def test_the_training_extra_installs_the_imports_of_the_environment(wheel: Path, tmp_path: Path) -> None:
    training = install(wheel, tmp_path / "venv", "gymnasium")
    done = training.run("python", "-c", "import deltaq_experiments.training.environment")
    assert done.returncode == 0, done.stderr
    assert "mcap" in missing(training)


def test_without_gymnasium_the_environment_names_the_extra_to_install() -> None:
    code = "import sys; sys.modules['gymnasium'] = None; import deltaq_experiments.training"
    done = ran([sys.executable, "-c", code], check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].endswith(
        "gymnasium is not installed: pip install 'deltaq[gymnasium]'"
    )


def test_a_missing_module_of_deltaq_is_not_reported_as_a_missing_extra() -> None:
    code = "import sys; sys.modules['deltaq_deploy.command.app'] = None; import deltaq_deploy.command as c; c.main()"
    done = ran([sys.executable, "-c", code], check=False)
    assert done.returncode == 1
    assert "ModuleNotFoundError" in done.stderr


@pytest.mark.nightly
def test_pytest_finds_the_plug_in_of_an_installed_wheel(complete: Installed, tmp_path: Path) -> None:
    for package in ("iniconfig", "packaging", "pluggy", "Pygments", "pytest"):
        complete.add(package)
    listed = complete.run(
        "python", "-m", "pytest", "--fixtures", "--markers", "-p", "no:cacheprovider", str(tmp_path)
    )
    assert "@pytest.mark.deltaq(cell='lab', robot=None, seed=0)" in listed.stdout, listed.stderr


def test_the_install_page_names_every_user_extra() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"]) - {"dev", "docs"}
    named = re.findall(r"deltaq\[(\w+)\]", INSTALL_PAGE.read_text(encoding="utf-8"))
    assert set(named) == extras
