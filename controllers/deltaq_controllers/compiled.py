"""Functions compiled to machine code, so that a law costs its arithmetic and not what Python takes to call numpy.

They stay Python, typed and tested as such: with `NUMBA_DISABLE_JIT=1` they run as they stand. The machine code is
kept on disk. Whether it is out of date numba tells by the file of a function, but not by the files of the functions
that it calls; so it is kept in a folder named after the sources of all compiled functions.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Decorate a function of numbers, arrays and named tuples of them, which calls none but such functions.

    It is compiled at its first call with arguments of new types, or found where an earlier process left it. Numbers
    are as numpy has them: a division by zero is infinite.
    """
    users_own = numba.config.CACHE_DIR
    # numba asks for its folder while it decorates, and others may want theirs elsewhere
    numba.config.CACHE_DIR = _FOLDER
    try:
        return cast(Function, numba.njit(cache=bool(_FOLDER), error_model="numpy")(function))
    finally:
        numba.config.CACHE_DIR = users_own


def folder_of(package: Path, users_cache: Path) -> str:
    """Where to keep the machine code of a package: beside the code, or else in the user's cache.

    What was installed with code that cannot be written to is copied there.

    Returns:
        The folder; empty if neither can be written to: then every process compiles anew.
    """
    sources = [path.read_bytes() for path in sorted(package.rglob("*.py"))]
    version = hashlib.sha256(b"".join(source for source in sources if b"\n@compiled" in source)).hexdigest()
    installed = package / "__pycache__" / f"compiled-{version[:16]}"
    if _can_be_written(installed):
        return str(installed)
    if not users_cache.is_absolute():  # nobody's, or as XDG does not want it
        return ""
    own = users_cache / "deltaq" / installed.name
    if installed.exists() and not own.exists():
        with suppress(OSError):  # in part it is of use, too
            shutil.copytree(installed, own)
    return str(own) if _can_be_written(own) else ""


def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _users_cache() -> Path:
    with suppress(RuntimeError):  # a user without a home
        return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return Path()


_FOLDER = folder_of(Path(__file__).parent, _users_cache())
