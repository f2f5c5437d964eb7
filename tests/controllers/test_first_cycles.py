"""No cycle waits for the compiler, its cache, or a module: all of that is ready before the lease is taken."""

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
from ran import ran

import deltaq_controllers

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]

COMPILED = [case for case in first_cycles.CASES if not case.startswith(("leader", "attacker"))]
EACH_KIND = ("qp", "attacker", "counsel-gr", "operated-fr")
"""Cases that stand for their kind in every run; the others take their turn at night."""

SUPPORT = Path(published_arms.__file__).parent


def waited(case: str, before: Path | None = None) -> dict[str, Any]:
    """What a case waited for before its lease, and while it held it; packages in `before` go before all others."""
    paths = [str(before)] * (before is not None) + [str(SUPPORT), os.environ.get("PYTHONPATH", "")]
    done = ran(
        [sys.executable, first_cycles.__file__, case],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
    )
    told: dict[str, Any] = json.loads(done.stdout)
    return told


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case in EACH_KIND else pytest.mark.nightly)
        for case in first_cycles.CASES
    ],
)
def test_nothing_is_compiled_loaded_or_imported_while_a_robot_is_leased(case: str) -> None:
    told = waited(case)
    assert told["late"] == {"functions": [], "modules": []}
    # what it needs was seen, so that it would have been seen late
    assert bool(told["early"]["functions"]) == (case in COMPILED)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "case", ["modes-panda", "modes-gr", "criteria-panda", "counsel-panda", "paper", "qp"]
)
def test_nothing_is_compiled_during_a_lease_after_an_empty_cache(case: str, tmp_path: Path) -> None:
    package = Path(deltaq_controllers.__file__).parent
    shutil.copytree(package, tmp_path / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    told = waited(case, before=tmp_path)
    assert told["late"] == {"functions": [], "modules": []}
    assert told["early"]["functions"]


@pytest.mark.nightly
def test_driving_by_hand_compiles_nothing_after_preparation(tmp_path: Path) -> None:
    package = Path(deltaq_controllers.__file__).parent
    shutil.copytree(package, tmp_path / package.name, ignore=shutil.ignore_patterns("__pycache__"))

    def compiled() -> set[Path]:
        return set(tmp_path.rglob("*.nbc"))

    paths = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", "")))
    environment = {**os.environ, "PYTHONPATH": paths}
    subprocess.run([sys.executable, "-m", "deltaq_controllers.modes"], env=environment, check=True)
    ahead = compiled()
    assert ahead
    for case in ("modes-gr", "operated-gr", "counsel-gr", "modes-dawm"):
        assert waited(case, before=tmp_path)["late"] == {"functions": [], "modules": []}
    assert compiled() == ahead


@pytest.mark.nightly
def test_nothing_is_compiled_while_an_arm_without_a_closed_form_is_leased(tmp_path: Path) -> None:
    (tmp_path / "eaik").mkdir()
    (tmp_path / "eaik" / "__init__.py").write_text("raise ImportError('not installed')\n")
    for case in ("modes-panda", "counsel-panda"):
        told = waited(case, before=tmp_path)
        assert told["late"] == {"functions": [], "modules": []}
        assert told["early"]["functions"]
