"""Compiling the gate and the controllers before anything runs that their compiler could make late.

The gate's kernel takes numba half a minute on a small machine, a camera law up to a minute. Beside a running cell that
is a minute in which services share their cores with a compiler, and in which the gate or the controller is not there.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from deltaq_launch.child_process import start_with_lines
from deltaq_launch.errors import LaunchError
from deltaq_launch.warden import Warden

GATE_COMPILER = ("-m", "deltaq_cell")
COMPILER = ("-m", "deltaq_controllers.camera")
COMPILES = "compiling "
"""Beginning of a line about a function that is being compiled."""
NOWHERE = "no folder for machine code can be written to: every start recompiles; XDG_CACHE_HOME may name one"


@contextmanager
def compiled_ahead(
    controllers: Sequence[str], tell: Callable[[str], None], on_function: Callable[[str], None]
) -> Iterator[None]:
    """Have the gate and camera controllers compiled, by processes that end with it; within the block nobody does again.

    Args:
        controllers: names of camera controllers that come with the project, if any are to run.
        tell: called with what the user has to know.
        on_function: called with the name of each function before it is compiled; never if all are kept from before.

    Raises:
        LaunchError: if they cannot be compiled, with the compiler's last words.
    """
    from deltaq_cell.machine_code import folder, package_of

    if all(folder(package_of(name)) for name in ("deltaq_cell", "deltaq_controllers")):
        _compile(controllers, on_function)
        yield
        return
    tell(NOWHERE)
    try:
        cache = tempfile.TemporaryDirectory(prefix="deltaq-")
    except OSError:
        yield  # not even for the time of this run
        return
    with cache as kept:
        # the processes of this run find it there
        before = os.environ.get("XDG_CACHE_HOME")
        os.environ["XDG_CACHE_HOME"] = kept
        try:
            _compile(controllers, on_function)
            yield
        finally:
            del os.environ["XDG_CACHE_HOME"]
            if before is not None:
                os.environ["XDG_CACHE_HOME"] = before


def _compile(controllers: Sequence[str], on_function: Callable[[str], None]) -> None:
    _run(GATE_COMPILER, "the gate's kernel", on_function)
    if controllers:
        _run((*COMPILER, *controllers), "the camera's controllers", on_function)


def _run(arguments: Sequence[str], what: str, on_function: Callable[[str], None]) -> None:
    command = [sys.executable, *arguments]
    said: list[str] = []
    # in its own session: Ctrl-C on the terminal reaches the waiting program, which ends it from here
    with Warden() as warden, start_with_lines(command) as compiler:
        assert compiler.stdout is not None  # a pipe was asked for
        warden.keep(compiler.pid, compiler.stdout.fileno())
        try:
            for line in compiler.stdout:
                said.append(line.rstrip("\n"))
                if line.startswith(COMPILES):
                    on_function(said[-1].removeprefix(COMPILES))
        except BaseException:
            compiler.kill()
            raise
    if compiler.returncode:
        words = "\n".join(f"  {line}" for line in said if not line.startswith(COMPILES))
        raise LaunchError(f"{what} could not be compiled:\n{words}")
