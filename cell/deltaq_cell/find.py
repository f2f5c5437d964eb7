"""Where cell descriptions, and the files that they name, are found.

Cells come from other packages (deltaq's own are part of its deployment), which this room does not know:
a package registers its folder of cells as an entry point of the group `deltaq.cells`.
"""

import difflib
import os
import sys
from collections.abc import Iterator
from functools import lru_cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

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
                f"no file '{name}': {names} in {candidate.parent} are the same name to a KRC; keep the loaded file"
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


# Files that a robot's model names: beside it, or in a package of ROS or of Python.

SCHEMES = ("package://", "model://")
ROS_PATH = "ROS_PACKAGE_PATH"
AMENT_PATH = "AMENT_PREFIX_PATH"


def find_file(name: str, folder: Path | None = None) -> Path:
    """The file that a model means by a name.

    `package://robot/meshes/arm.stl` is `meshes/arm.stl` in the folder of the package `robot`, which is searched for
    above `folder`, in `$ROS_PACKAGE_PATH`, as `share/robot` of `$AMENT_PREFIX_PATH`, and among the installed Python
    packages: those that are a module `robot`, and those that contain models as `share/robot`, such as
    example-robot-data. A name without a scheme is relative to `folder`; in one with a scheme, `%20` is a space.

    Args:
        name: as the model writes it.
        folder: folder of the model's own file; None if the model was given as text.

    Raises:
        FileNotFoundError: there is no such file; the message says where it was searched for, and what to set.
    """
    scheme = next((scheme for scheme in SCHEMES if name.startswith(scheme)), None)
    if scheme is None:
        return _beside(_path_of(name), folder)
    package, _, rest = unquote(name.removeprefix(scheme)).partition("/")
    tried = list(dict.fromkeys(_homes(package, folder)))
    for home in tried:
        if rest and is_file(home / rest):
            return home / rest
    looked = ", ".join(str(home) for home in tried) or "no folder of that name"
    raise FileNotFoundError(
        f"no file '{name}': looked into {looked}; set {ROS_PATH} to the folder that holds '{package}', or "
        f"{AMENT_PATH} to the prefix whose share/ does"
    )


def is_file(path: Path) -> bool:
    """Whether there is such a file; none is there whose name is too long, or whose folder cannot be read."""
    return os.path.isfile(path)  # noqa: PTH113 - pathlib's raises


def is_folder(path: Path) -> bool:
    """The entry is a folder."""
    return os.path.isdir(path)  # noqa: PTH112 - pathlib's raises


def _path_of(name: str) -> str:
    """The path that a name without a package means; `file://` begins a URI (RFC 8089)."""
    if not name.startswith("file://"):
        return name
    path = unquote(name.removeprefix("file://"))
    return path.removeprefix("localhost") if path.startswith("localhost/") else path


def _beside(name: str, folder: Path | None) -> Path:
    path = Path(name) if folder is None else folder / name
    if is_file(path) and (folder is not None or path.is_absolute()):
        return path
    where = "no folder to search is known" if folder is None else f"looked for {path}"
    raise FileNotFoundError(
        f"no file '{name}': {where}; a name without package:// is taken from the model's folder"
    )


def _homes(package: str, folder: Path | None) -> Iterator[Path]:
    """Candidate folders of a package of that name, those nearer to the model first."""
    if not package:
        return
    candidates: list[Path] = []
    if folder is not None:
        candidates += [above / package for above in (folder, *folder.parents)]
    for entry in _entries(ROS_PATH):
        candidates += [entry, entry / package] if entry.name == package else [entry / package]
    candidates += [entry / "share" / package for entry in _entries(AMENT_PATH)]
    candidates += _modules(package)
    candidates += [Path(entry) / "cmeel.prefix" / "share" / package for entry in sys.path]
    yield from (candidate for candidate in candidates if is_folder(candidate))


def _entries(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _modules(package: str) -> list[Path]:
    if not package.isidentifier() or package == "__main__":
        return []
    spec = find_spec(package)  # of a top-level package, which is found without running it
    return [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
