"""No cycle waits for the compiler, its cache, or a module: all of that is ready before the lease is taken."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import first_cycles
import published_arms
import pytest

import deltaq_controllers

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]

COMPILED = [case for case in first_cycles.CASES if not case.startswith(("leader", "attacker"))]


SUPPORT = Path(published_arms.__file__).parent


def waited(*cases: str, before: Path | None = None) -> dict[str, dict[str, Any]]:
    """By case, what it waited for before its lease, and while it held it; packages in `before` go before all others."""
    paths = [str(before)] * (before is not None) + [str(SUPPORT), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, first_cycles.__file__, *cases],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return {told["case"]: told for told in map(json.loads, done.stdout.splitlines())}


@pytest.fixture(scope="module")
def all_cases() -> dict[str, dict[str, Any]]:
    return waited(*first_cycles.CASES)


@pytest.mark.parametrize("case", first_cycles.CASES)
def test_nothing_is_compiled_loaded_or_imported_while_a_robot_is_leased(
    all_cases: dict[str, dict[str, Any]], case: str
) -> None:
    told = all_cases[case]
    assert told["late"] == {"functions": [], "modules": []}
    # what it needs was seen, so that it would have been seen late
    assert bool(told["early"]["functions"]) == (case in COMPILED)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "case", ["modes-panda", "modes-gr", "criteria-panda", "counsel-panda", "paper", "qp"]
)
def test_nothing_is_compiled_while_a_robot_is_leased_where_nothing_was_before(
    case: str, tmp_path: Path
) -> None:
    package = Path(deltaq_controllers.__file__).parent
    shutil.copytree(package, tmp_path / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    told = waited(case, before=tmp_path)[case]
    assert told["late"] == {"functions": [], "modules": []}
    assert told["early"]["functions"]


@pytest.mark.nightly
def test_nothing_is_compiled_while_an_arm_without_a_closed_form_is_leased(tmp_path: Path) -> None:
    (tmp_path / "eaik").mkdir()
    (tmp_path / "eaik" / "__init__.py").write_text("raise ImportError('not installed')\n")
    cases = ("modes-panda", "counsel-panda")
    told = waited(*cases, before=tmp_path)
    for case in cases:
        assert told[case]["late"] == {"functions": [], "modules": []}
        assert told[case]["early"]["functions"]
