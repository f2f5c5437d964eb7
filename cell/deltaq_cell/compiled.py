"""Functions compiled to machine code, to avoid the cost of numpy calls from Python.

They stay Python, typed and tested as such: with `NUMBA_DISABLE_JIT=1` they run as they stand. The machine code is
kept on disk. Numba notices a change in a function's own file, but not in the files of the functions that it calls.
So the code is kept in a folder named after a hash of all compiled sources of its package and of the gate's kernel.
Within that folder a module is found by its path in the package, so the folder can be copied to another installation.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event
from numba.core.caching import UserProvidedCacheLocator
from numba.extending import register_jitable

from deltaq_cell.machine_code import folder, package_of

__all__ = ["compiled", "copied", "inlined", "makes_no_array", "told_of_compiling"]

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Decorate a function of numbers, arrays and named tuples of them, which calls none but such of its package.

    It is compiled at its first call with arguments of new types, or found where an earlier process left it. Numbers
    are as numpy has them: a division by zero is infinite.
    """
    return _to_machine_code(function)


def inlined(function: Function) -> Function:
    """Decorate a function that makes no array, and becomes part of every compiled function that calls it.

    For short functions of named tuples: to hand over some thirty arrays costs several times what such a function does.
    Whoever calls one that returns arrays in a named tuple must make none, either: nobody counts that tuple as a user.
    Called from Python it stays Python.
    """
    # LLVM puts it in place; numba could, but copies whatever it has put there before: a chain of them takes minutes
    no_entry = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    jitable = register_jitable(error_model="numpy", forceinline=True, _nrt=False, **no_entry)
    return cast(Function, jitable(function))


def makes_no_array(function: Function) -> Function:
    """Decorate a compiled function that only reads and writes arrays that it is given, and returns none to Python.

    For all others numba counts the users of an array wherever one of its rows is looked at, with an instruction that
    locks the memory: as long again as all that the gate computes.
    """
    return _to_machine_code(function, counts_users=False)


def copied(function: Function) -> Function:
    """Decorate a function that makes no array, and that one compiled function has as a part of its own text.

    For one that calls a large function: whatever is compiled by itself has all that it calls optimised once more.
    """
    return cast(Function, numba.njit(inline="always", error_model="numpy", _nrt=False)(function))


def _to_machine_code(function: Function, counts_users: bool = True) -> Function:
    users_own = numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES
    kept = _folder(function.__module__)
    # numba asks for its folder while it decorates, and others may want theirs elsewhere
    numba.config.CACHE_DIR = kept
    numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.{_PlaceInPackage.__name__}" if kept else users_own[1]
    try:
        # numba's option has no public name; what makes an array all the same is refused when it is compiled
        decorate = numba.njit(cache=bool(kept), error_model="numpy", _nrt=counts_users)
        return cast(Function, decorate(function))
    finally:
        numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES = users_own


class _PlaceInPackage(UserProvidedCacheLocator):  # type: ignore[misc] # numba ships no type information
    """Keeps a function's machine code by its module's place in the package, and not by where that is installed."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Name of the folder for the functions of a file."""
        folders = [Path(py_file).parent]
        while (folders[-1] / "__init__.py").exists():
            folders.append(folders[-1].parent)
        return "-".join(folder.name for folder in reversed(folders[:-1])) or folders[0].name


@contextmanager
def told_of_compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Call `tell` with the name of every function that is compiled within the block, before it is.

    A function that is found on disk is not compiled, and not reported.
    """

    class Teller(event.Listener):  # type: ignore[misc] # numba ships no type information
        def on_start(self, event: Any) -> None:
            tell(event.data["dispatcher"].py_func.__qualname__)

        def on_end(self, event: Any) -> None:
            """The end is not reported; numba requires the method."""

    with event.install_listener("numba:compile", Teller()):
        yield


def _folder(module: str) -> str:
    return _folder_of(package_of(module))


_folder_of = cache(folder)
