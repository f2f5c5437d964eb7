"""Where cell descriptions, and the files that they name, are found.

Cells come from other packages (deltaq's own are part of its deployment), which this room does not know:
a package registers its folder of cells as an entry point of the group `deltaq.cells`.
"""

from __future__ import annotations

import difflib
import os
import sys
from functools import lru_cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from deltaq_cell.packages import is_file, is_folder
from deltaq_cell.problems import CellError, Problem

CELLS_VARIABLE = "DELTAQ_CELLS"
"""Environment variable: folders to search for cells before the registered ones, separated as in PATH."""
ENTRY_POINTS = "deltaq.cells"
SUFFIXES = (".yaml", ".yml")


def cell_folders() -> list[Path]:
    """Folders in which cells are looked up by name: those of `$DELTAQ_CELLS`, then the registered ones."""
    given = os.environ.get(CELLS_VARIABLE, "")
    folders = [Path(folder) for folder in given.split(os.pathsep) if folder]
    return [folder for folder in (*folders, *_registered_folders(tuple(sys.path))) if is_folder(folder)]


def cell_names() -> list[str]:
    """Names of all cells that can be loaded by name."""
    return sorted({file.stem for folder in cell_folders() for file in folder.iterdir() if _is_cell(file)})


def find_cell(name_or_path: str | Path) -> Path:
    """The file of a cell.

    Args:
        name_or_path: a path (with a separator, or ending in .yaml or .yml), or the name of a cell in one of
            `cell_folders`.

    Raises:
        CellError: there is none; close names are suggested.
    """
    text = str(name_or_path)
    path = Path(name_or_path)
    is_path = path.suffix in SUFFIXES or os.sep in text
    if is_path and is_file(path):
        return path
    if os.sep not in text:
        stem = path.stem if path.suffix in SUFFIXES else text
        for folder in cell_folders():
            for suffix in SUFFIXES:
                if is_file(found := folder / f"{stem}{suffix}"):
                    return found
    raise CellError([_missing(text, path, is_path)])


def resolve_near(cell_file: str | Path, name: str | Path) -> Path:
    """The path of a KRC's file that a cell names, e.g. its `ethernet_xml`.

    It is looked up beside the cell's file, then in the folder `krc` beside the cell's folder, then likewise
    for every folder of `cell_folders`. An absolute path is not searched for. Names ignore case, as on a KRC; of
    several that differ by case alone, the one that is written as in the cell counts.

    Raises:
        FileNotFoundError: it is in none of them, or several differ from it by case alone; the message says where.
    """
    if Path(name).is_absolute():
        candidates = [Path(name)]
    else:
        folders = [Path(cell_file).resolve().parent, *cell_folders()]
        candidates = [place / name for folder in folders for place in (folder, folder.parent / "krc")]
    for candidate in candidates:
        if is_file(candidate):
            return candidate
        same = same_to_a_krc(candidate.parent, candidate.name)
        if len(same) > 1:
            names = " and ".join(file.name for file in same)
            raise FileNotFoundError(
                f"no file '{name}': {names} in {candidate.parent} are one name to a KRC; keep the one that it has "
                "loaded"
            )
        if same:
            return same[0]
    looked = ", ".join(dict.fromkeys(str(candidate.parent) for candidate in candidates))
    raise FileNotFoundError(f"no file '{name}' in {looked}")


def same_to_a_krc(folder: Path, name: str) -> list[Path]:
    """Files of a folder that a KRC cannot tell from one of that name, since its names ignore case; sorted."""
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.name.lower() == name.lower() and file.is_file())


@lru_cache(maxsize=1)
def _registered_folders(search_path: tuple[str, ...]) -> tuple[Path, ...]:  # noqa: ARG001 - what is kept depends on it
    """Folders that packages registered; kept, as a look into everything that is installed takes 20 ms."""
    folders = []
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name):
        package, *below = entry.module.split(".")
        spec = find_spec(package)  # of a top-level package: finds it without running it
        folders += [Path(root, *below) for root in (spec.submodule_search_locations or [])] if spec else []
    return tuple(folders)


def _is_cell(file: Path) -> bool:
    return file.suffix in SUFFIXES and file.is_file()


def _missing(text: str, path: Path, is_path: bool) -> Problem:
    if is_path and is_folder(path):
        return Problem(text, 0, "", "is a folder; name the YAML file in it", value=text)
    if is_path:
        beside = (
            [file.name for file in path.parent.iterdir() if _is_cell(file)] if is_folder(path.parent) else []
        )
        near = difflib.get_close_matches(path.name, beside, n=1)
        allowed = f"a file, or one of the cells {', '.join(cell_names())}"
        message = "no such file"
    else:
        near = difflib.get_close_matches(text, cell_names(), n=1)
        allowed = ", ".join(cell_names())
        message = f"no cell of that name; there are {allowed or 'none'} (a file's path works too)"
    if near:
        message += f"; did you mean '{near[0]}'?"
    return Problem(text, 0, "", message, value=text, bound=allowed, suggestion=near[0] if near else None)
