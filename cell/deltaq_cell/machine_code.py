"""Where machine code is kept between starts, and which of it is complete. Imports nothing heavy."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

_HERE = Path(__file__).parent
"""The package of the gate's kernel, of which the machine code of other packages may hold functions."""

_DECORATES = re.compile(rb"^@(compiled|copied|inlined|makes_no_array)$", re.MULTILINE)
"""What makes machine code of a function, see `deltaq_cell.compiled`."""


def folder_of(package: Path, users_cache: Path) -> str:
    """Where to keep the machine code of a package: beside the code, or else in the user's cache.

    Machine code from an installation that cannot be written to is copied there.

    Returns:
        The folder; empty if neither can be written to: then every process recompile.
    """
    sources = [path.read_bytes() for each in {_HERE, package} for path in sorted(each.rglob("*.py"))]
    compiled = [source for source in sources if _DECORATES.search(source) or b"(NamedTuple)" in source]
    version = hashlib.sha256(b"".join(sorted(compiled))).hexdigest()
    installed = package / "__pycache__" / f"compiled-{version[:16]}"
    if _can_be_written(installed):
        return str(installed)
    if not users_cache.is_absolute():  # no home, or a relative path, which XDG does not allow
        return ""
    own = users_cache / "deltaq" / installed.name
    if installed.exists() and not own.exists():
        with suppress(OSError):  # a partial copy is useful, too
            shutil.copytree(installed, own)
    return str(own) if _can_be_written(own) else ""


def package_of(module: str) -> Path:
    """The folder of the package that a module is in, by name; of a script, that of this package."""
    found = find_spec(module.partition(".")[0]) if module != "__main__" else None
    origin = found.origin if found is not None and found.submodule_search_locations else None
    return Path(origin or __file__).parent


def folder(package: Path) -> str:
    """The folder of a package, as `folder_of` finds it now."""
    return folder_of(package, _users_cache())


def is_complete(where: str, name: str, package: Path) -> bool:
    """Whether all that `name` of a package needs was compiled for this machine."""
    return bool(where) and _mark(where, name, package).exists()


def mark_complete(where: str, name: str, package: Path) -> None:
    """Remember that all that `name` of a package needs was compiled for this machine."""
    if where:
        with suppress(OSError):  # then it is looked at again at the next start
            _mark(where, name, package).touch()


def _mark(where: str, name: str, package: Path) -> Path:
    """A file whose name is a hash of all that makes numba compile again: code, versions, the processor."""
    sources = [path.read_bytes() for path in sorted(package.rglob("*.py"))]
    processor = [platform.machine(), platform.processor()]
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    parts = (version("numba"), version("llvmlite"), sys.implementation.cache_tag, *processor, *sources)
    return Path(where) / f"{name}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:16]}.complete"


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


TELLS_EACH = "DELTAQ_TELLS_EACH_FUNCTION"
"""Environment variable, set for a compiler by a program that counts for itself."""
_TOLD_EVERY = 20
"""Functions; where there is a terminal, one line counts them all."""


@contextmanager
def compiling_shown(what: str, about: int) -> Iterator[None]:
    """Print the progress of compilation within the block; nothing if nothing is compiled.

    Args:
        what: is compiled.
        about: how many functions that is, to estimate from.
    """
    from deltaq_cell.compiled import told_of_compiling  # loads numba

    count, end = 0, "\r" if sys.stdout.isatty() else "\n"

    def show(function: str) -> None:
        nonlocal count
        if TELLS_EACH in os.environ:
            print(f"compiling {function}", flush=True)
            return
        if end == "\r" or count % _TOLD_EVERY == 0:
            print(
                f"compiling {what}: {count} of about {max(about, count + 1)} functions", end=end, flush=True
            )
        count += 1

    with told_of_compiling(show):
        yield
    if count:
        print(f"compiled {what}: {count} functions" + (30 * " " if end == "\r" else ""), flush=True)
