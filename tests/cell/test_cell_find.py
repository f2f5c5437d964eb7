"""Where cells and the files that they name are looked up."""

from pathlib import Path

import pytest

from deltaq_cell.find import CELLS_VARIABLE, cell_folders, cell_names, find_cell, resolve_near
from deltaq_cell.problems import CellError


def test_a_path_is_used_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("cell: mine")
    assert find_cell(path) == path
    assert find_cell(str(path)) == path


def test_folders_of_the_environment_precede_registered_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "lab.yaml").write_text("cell: mine")
    monkeypatch.setenv(CELLS_VARIABLE, f"{tmp_path / 'empty'}:{tmp_path / 'gone'}:{tmp_path}")
    assert cell_folders()[:2] == [tmp_path / "empty", tmp_path]
    assert find_cell("lab") == tmp_path / "lab.yaml"
    assert find_cell("lab.yaml") == tmp_path / "lab.yaml"
    assert find_cell("lab-4ms").parent == cell_folders()[-1]


def test_a_file_in_the_working_folder_does_not_shadow_a_named_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab").write_text("something else")
    monkeypatch.chdir(tmp_path)
    assert find_cell("lab").name == "lab.yaml"


def test_the_shipped_cells_are_registered() -> None:
    assert {"lab", "lab-4ms"} <= set(cell_names())


@pytest.mark.parametrize(
    ("name", "message", "suggestion"),
    [
        ("labb", "no cell of that name; there are dawm, lab, lab-4ms, lab-aside, lab-open, lab-tools", "lab"),
        ("zzzzzz", "no cell of that name", None),
        ("", "no cell of that name", None),
        ("{folder}/mien.yaml", "no such file", "mine.yaml"),
        ("{folder}/gone/mine.yaml", "no such file", None),
        ("{folder}", "is a folder", None),
        ("la.yaml", "no such file", None),
    ],
)
def test_an_unknown_name_is_answered_with_similar_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, message: str, suggestion: str | None
) -> None:
    (tmp_path / "mine.yaml").write_text("cell: mine")
    monkeypatch.chdir(tmp_path.parent)
    with pytest.raises(CellError) as caught:
        find_cell(name.format(folder=tmp_path))
    (problem,) = caught.value.problems
    assert message in problem.message
    assert problem.suggestion == suggestion
    assert suggestion is None or f"did you mean '{suggestion}'?" in problem.message


def test_files_of_a_cell_are_searched_beside_it_then_in_krc_then_in_the_package(
    tmp_path: Path,
) -> None:
    cells, krc = tmp_path / "cells", tmp_path / "krc"
    cells.mkdir()
    krc.mkdir()
    cell = cells / "mine.yaml"
    cell.write_text("cell: mine")
    (krc / "one.xml").write_text("krc")
    assert resolve_near(cell, "one.xml") == krc / "one.xml"
    (cells / "one.xml").write_text("beside")
    assert resolve_near(cell, "one.xml") == cells / "one.xml"
    assert resolve_near(cell, krc / "one.xml") == krc / "one.xml"
    assert resolve_near(cell, "fr_ethernet.xml").parent.name == "krc"
    with pytest.raises(FileNotFoundError, match=r"no file 'two\.xml' in .*cells, .*krc"):
        resolve_near(cell, "two.xml")
    with pytest.raises(FileNotFoundError, match=r"no file '/two\.xml'"):
        resolve_near(cell, "/two.xml")
