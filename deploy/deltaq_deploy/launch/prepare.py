"""Compiling the gate and the controllers before anything runs that their compiler could make late.

The gate's kernel takes numba a minute or two on a small machine, a camera law up to a minute, driving by hand a quarter
of one. Beside a running cell that is time in which services share their cores with a compiler, and in which the gate or
the controller is not there. So all of it comes first, side by side.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass

from deltaq_cell.description import CellDescription
from deltaq_cell.machine_code import TELLS_EACH
from deltaq_controllers.camera import FOLLOWS
from deltaq_deploy.launch.child_process import start_with_lines
from deltaq_deploy.launch.program import LaunchError
from deltaq_deploy.launch.services import Role, Service
from deltaq_deploy.launch.warden import Warden

GATE_COMPILER = ("-m", "deltaq_cell")
CAMERA_COMPILER = ("-m", "deltaq_controllers.camera")
MODES_COMPILER = ("-m", "deltaq_controllers.modes")
COMPILES = "compiling "
"""Beginning of a line about a function that is being compiled."""
NOWHERE = "no folder for machine code is writable: every start compiles again; XDG_CACHE_HOME may name one"


@dataclass(frozen=True)
class Needed:
    """The functions to compile.

    Attributes:
        controllers: names of camera controllers that come with the project, if any are to run.
        by_hand: name or YAML file of the cell whose robots are driven by hand, if any are.
        gate: whether a gate is to run.
    """

    controllers: Sequence[str] = ()
    by_hand: str | None = None
    gate: bool = True

    @property
    def functions(self) -> int:
        """About how many functions are compiled, where none are kept."""
        from deltaq_cell import __main__ as gate
        from deltaq_controllers.camera import __main__ as camera
        from deltaq_controllers.modes import __main__ as modes

        by_hand = 0 if self.by_hand is None else modes.FUNCTIONS
        return gate.FUNCTIONS * self.gate + camera.FUNCTIONS * len(self.controllers) + by_hand


def needed_by(services: Sequence[Service], cell: CellDescription, cell_name: str) -> Needed:
    """What services need, those among them that a console starts.

    Args:
        services: to be started.
        cell: its description.
        cell_name: the name or path to load it by.
    """
    roles = {service.role for service in services}
    at_console = Role.CONSOLE in roles
    has_camera = any(robot.camera is not None for robot in cell.robots.values())
    follows = Role.FOLLOWER in roles or (at_console and has_camera)
    return Needed((FOLLOWS,) if follows else (), cell_name if at_console else None, Role.SIM in roles)


@contextmanager
def compiled_ahead(
    needed: Needed, tell: Callable[[str], None], on_function: Callable[[str], None]
) -> Iterator[None]:
    """Compile what the block needs, in separate processes; within the block nothing is compiled again.

    Args:
        needed: functions of the services in the block.
        tell: called with messages for the user.
        on_function: called with the name of each function before it is compiled; never if all are kept from before.

    Raises:
        LaunchError: if something cannot be compiled, with its compiler's last words.
    """
    from deltaq_cell.machine_code import folder, package_of

    if all(folder(package_of(name)) for name in ("deltaq_cell", "deltaq_controllers")):
        _compile(needed, on_function)
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
            _compile(needed, on_function)
            yield
        finally:
            del os.environ["XDG_CACHE_HOME"]
            if before is not None:
                os.environ["XDG_CACHE_HOME"] = before


def _compile(needed: Needed, on_function: Callable[[str], None]) -> None:
    wanted: dict[str, Sequence[str]] = {}
    if needed.gate:
        wanted["the gate's kernel"] = GATE_COMPILER
    if needed.controllers:
        wanted["the camera's controllers"] = (*CAMERA_COMPILER, *needed.controllers)
    if needed.by_hand is not None:
        wanted["the modes of driving by hand"] = (*MODES_COMPILER, needed.by_hand)
    if not wanted:
        return
    one_at_a_time = threading.Lock()

    def told(function: str) -> None:
        with one_at_a_time:
            on_function(function)

    compilers: list[subprocess.Popen[str]] = []
    with Warden() as warden, ThreadPoolExecutor(len(wanted)) as threads:
        try:
            listening = []
            for what, arguments in wanted.items():
                # in its own session: Ctrl-C on the terminal reaches the waiting program, which ends it from here
                compiler = start_with_lines([sys.executable, *arguments], {TELLS_EACH: "1"})
                compilers.append(compiler)
                assert compiler.stdout is not None  # a pipe was asked for
                warden.keep(compiler.pid, compiler.stdout.fileno())
                listening.append(threads.submit(_listen, compiler, what, told))
            ended, _ = wait(listening, return_when=FIRST_EXCEPTION)
            for each in ended:
                each.result()
        except BaseException:
            for compiler in compilers:
                compiler.kill()
            raise


def _listen(compiler: subprocess.Popen[str], what: str, on_function: Callable[[str], None]) -> None:
    """Pass on a compiler's output until it ends."""
    said: list[str] = []
    with compiler:
        assert compiler.stdout is not None  # a pipe was asked for
        for line in compiler.stdout:
            said.append(line.rstrip("\n"))
            if line.startswith(COMPILES):
                on_function(said[-1].removeprefix(COMPILES))
    if compiler.returncode:
        words = "\n".join(f"  {line}" for line in said if not line.startswith(COMPILES))
        raise LaunchError(f"{what} could not be compiled:\n{words}")
