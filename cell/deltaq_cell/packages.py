"""Files that a robot's model names: beside it, or in a package of ROS or of Python."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

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
    """The same for a folder."""
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
    where = "it came without a folder to look in" if folder is None else f"looked for {path}"
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
