"""The notebooks run from their first cell to their last, and show what they speak of."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import nbformat
import pytest
from installed import ROOT
from ran import ran

FOLDER = ROOT / "examples" / "notebooks"
BIN = Path(sys.executable).parent
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@dataclass(frozen=True)
class Outputs:
    """Of all cells of a notebook: what they printed, and how many pictures they drew."""

    printed: str
    pictures: int


def executed(name: str, folder: Path) -> Outputs:
    """Run a notebook as Jupyter does, without an error."""
    result = folder / name
    ran(
        [str(BIN / "jupyter-execute"), str(FOLDER / name), "--output", str(result)],
        env={**os.environ, "HOME": str(folder), "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"},
    )
    cells = nbformat.read(result, as_version=4).cells
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    return Outputs(
        printed="".join(output.get("text", "") for output in outputs),
        pictures=sum("image/png" in output.get("data", {}) for output in outputs),
    )


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.stem)
def test_notebooks_are_stored_without_outputs(notebook: Path) -> None:
    written = nbformat.read(notebook, as_version=4)
    nbformat.validate(written)
    code = [cell for cell in written.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code)


@pytest.mark.nightly
def test_an_own_controller_is_recorded_and_replayed(tmp_path: Path) -> None:
    seen = executed("own_controller.ipynb", tmp_path)
    assert "the same" in seen.printed
    assert "within limits: " in seen.printed
    assert seen.printed.count("0 scaled, 0 held") == 2, "only the law that forgets its limits was stopped"
    assert seen.pictures == 1


@pytest.mark.nightly
def test_the_advisor_shows_options_and_a_path(tmp_path: Path) -> None:
    seen = executed("advisor.ipynb", tmp_path)
    assert "1: energy" in seen.printed
    assert "a way is known" in seen.printed
    assert seen.pictures == 2


@pytest.mark.nightly
def test_a_first_motion_is_executed_limited_stopped_and_reset(tmp_path: Path) -> None:
    seen = executed("first_motion.ipynb", tmp_path)
    assert "A1 turned by 10.00 deg;" in seen.printed
    assert "limits kept: True - distances kept: True" in seen.printed
    assert "held: operator_stop" in seen.printed
    assert "A1 turned by 40.00 deg in all" in seen.printed
    assert seen.pictures == 2


@pytest.mark.nightly
def test_an_arm_without_a_cell_is_kept_clear_of_a_cupboard(tmp_path: Path) -> None:
    seen = executed("gate_alone.ipynb", tmp_path)
    assert "velocity / 0.4 s" in seen.printed
    assert "held clearance arm/" in seen.printed
    assert float(seen.printed.partition("nearest in all: ")[2].split()[0]) >= 5.0, "its own stop distance"
    assert seen.pictures == 1
