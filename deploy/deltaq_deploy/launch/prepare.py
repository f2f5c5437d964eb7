"""What comes before a launch: compiling the gate and the controllers, and judging the addresses of real robots.

The gate's kernel takes numba a minute or two on a small machine, a camera law up to a minute, driving by hand a quarter
of one. Beside a running cell that is time in which services share their cores with a compiler, and in which the gate or
the controller is not there. So all of it comes first, side by side.
"""

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_cell.find import resolve_near
from deltaq_cell.krc_files import judge_krc_files
from deltaq_cell.machine_code import TELLS_EACH
from deltaq_controllers.camera import FOLLOWS
from deltaq_deploy.launch.child_process import start_with_lines
from deltaq_deploy.launch.program import LaunchError
from deltaq_deploy.launch.services import Role, Service
from deltaq_deploy.launch.warden import Warden
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_protocol.rsi.judge import is_any, is_loopback

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


# Whether a cell's addresses can be those of real robots, checked before anything listens.


def refuse_unreal(cell: CellDescription, file: Path, robots: Iterable[str]) -> None:
    """Refuse addresses at which no real KRC can be, and files of a KRC that cannot be safe.

    A loopback both in the cell and in the KRC's file is accepted: an emulator that was started by hand.

    Args:
        cell: the cell.
        file: its file.
        robots: those whose Robot Server is to run here.

    Raises:
        DeltaqError: with every reason.
        EthernetConfigError: a `*_ethernet.xml` cannot be read.
    """
    if reasons := [reason for name in robots for reason in _reasons(cell, file, name)]:
        raise DeltaqError("\n".join(["this cell is not ready for real robots:", *reasons]))


def _reasons(cell: CellDescription, file: Path, name: str) -> Iterator[str]:
    robot = cell.robots[name]
    driver = robot.driver
    if not isinstance(driver, RsiDescription):
        return
    where = f"robots.{name}.driver"
    config = load_ethernet_xml(resolve_near(file, driver.ethernet_xml))
    if is_loopback(driver.address):
        if is_loopback(config.ip_number):
            return
        yield (
            f"{where}.address: {driver.address} is this machine's own, and no KRC reaches it; {config.source} lets the "
            f"KRC send to {config.ip_number}: write that, if it is this machine's address on the robot's network"
        )
    if driver.krc_address is None:
        yield (
            f"{where}.krc_address: is missing: any host's datagram would be taken for the KRC's; write the KRC's "
            "address on the robot's network"
        )
    elif is_loopback(driver.krc_address) or is_any(driver.krc_address):
        yield (
            f"{where}.krc_address: {driver.krc_address} is no address of a KRC; write the one on the robot's network"
        )
    elif driver.krc_address == driver.address:
        yield f"{where}.krc_address: {driver.krc_address} is this machine's own, as driver.address says"
    for finding in judge_krc_files(file, robot, cell.cycle_s):
        if finding.severity == "error":
            yield f"{'.'.join((where, *finding.field))}: {finding}"
