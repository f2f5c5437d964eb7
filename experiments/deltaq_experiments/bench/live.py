"""A cell at work, measured from outside and from the stamps of its processes: `deltaq bench --live`."""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from pydantic import BaseModel

from deltaq_cell.description import CellDescription
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.bring_to_rest import bring_to_rest
from deltaq_deploy.launch.child_process import Exited
from deltaq_deploy.launch.launcher import Interrupted, Launcher, describe_exit
from deltaq_deploy.launch.program import LaunchError, LaunchInterruptedError
from deltaq_deploy.launch.services import Role, Service, cell_services, demo_controllers
from deltaq_experiments.bench.bare_chain import BareChain, bare_rows, measured
from deltaq_experiments.bench.hop_reference import (
    HopTimes,
    hop_reference,
    machine_time,
    processor_seconds,
    wakeups,
)
from deltaq_experiments.bench.journeys import RobotStamps, by_robot
from deltaq_experiments.bench.live_figures import LiveRow, RobotFigures, bounded_rows, robot_figures
from deltaq_experiments.live import LastLines
from deltaq_protocol.stamps import FOLDER, WrittenStamps, read_stamps

STAMPING = (Role.ROBOT_SERVER, Role.SIM, Role.HLI, Role.LEADER, Role.FOLLOWER)
"""Services that write stamps when they end."""
BARE_S = 10.0
"""Longest measurement of the bare chain [s]."""
_TICK_S = 0.25
_END_TOLD_S = 5.0
"""Longest time until the launcher tells that a process has ended [s]."""


@dataclass(frozen=True)
class LiveOptions:
    """Options of the live benchmark.

    Attributes:
        cell: name or file of the cell.
        follower: camera controller of the follower.
        warm_up_s: from the first increments to the window that is measured [s].
        duration_s: of the window [s].
    """

    cell: str
    follower: str
    warm_up_s: float
    duration_s: float


class LiveRun(BaseModel, frozen=True):
    """The figures of one run.

    Attributes:
        robots: by name.
        processor_us: processor time of each process in a cycle [µs].
        wakeups: of the threads of each process, in a cycle.
        bare: the same messages in bare Python, after the cell has ended.
        reference: its cycles, and the share of its messages that were back in time.
        rows: bounds and comparisons.
        silent: processes without stamps; their stations are missing.
        overwritten: stamps that were lost because a ring was full.
    """

    robots: dict[str, RobotFigures]
    processor_us: dict[str, float]
    wakeups: dict[str, float]
    bare: BareChain
    reference: dict[str, float]
    rows: tuple[LiveRow, ...]
    silent: tuple[str, ...]
    overwritten: int

    @property
    def good(self) -> bool:
        """Whether all bounds are kept, and all requested figures were measured."""
        return not self.silent and all(row.kept is not False for row in self.rows)


def run_once(options: LiveOptions, on_time: Callable[[float], None] | None = None) -> LiveRun:
    """Start the cell, a leader and the follower; measure; end everything again.

    Args:
        options: of the run.
        on_time: called now and then with the time since all services are ready [s].

    Raises:
        LaunchError: if a service does not come up, or ends before its time.
        LaunchInterruptedError: if a signal came first.
        DeltaqError: if a reference fails.
    """
    cell = load_cell(options.cell)
    leader, follower = demo_controllers(cell)
    follower = replace(follower, arguments=(*follower.arguments, "--controller", options.follower))
    services = (*cell_services(cell, options.cell), leader, follower)
    on_time = on_time or (lambda _: None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        window = _run(cell, services, options, folder, on_time)
        sockets = folder / "bare"
        sockets.mkdir()
        on_time(options.warm_up_s + options.duration_s)
        bare = measured(list(cell.robots), cell.cycle_s, min(BARE_S, options.duration_s), sockets, time.sleep)
        files = sorted(folder.glob("*.stamps"))
        return _figures(cell, services, window, bare, [read_stamps(file) for file in files])


@dataclass(frozen=True)
class _Window:
    begin_ns: int
    end_ns: int
    processor_s: dict[str, float]
    wakeups: dict[str, float]
    reference: HopTimes
    reference_processor_s: float
    stolen_share: float | None


def _run(
    cell: CellDescription,
    services: Sequence[Service],
    options: LiveOptions,
    folder: Path,
    on_time: Callable[[float], None],
) -> _Window:
    python = ("env", f"{FOLDER}={folder}", sys.executable)
    lines = LastLines()
    launcher = Launcher(services, lines, partial(bring_to_rest, cell, "deltaq bench"), python=python)
    with launcher:
        launcher.start()
        wait = partial(_wait, launcher, lines, time.monotonic(), on_time)
        wait(options.warm_up_s)
        with hop_reference(cell.cycle_s, options.duration_s, folder) as reference:
            begin_ns = time.monotonic_ns()
            machine_before = machine_time()
            count = partial(_counted, launcher, wait)
            before, woken_before = count(processor_seconds), count(wakeups)
            reference_before = reference.processor_s()
            wait(options.duration_s)
            after, woken_after = count(processor_seconds), count(wakeups)
            reference_after = reference.processor_s()
            stolen_share = machine_time().stolen_share_since(machine_before)
            end_ns = time.monotonic_ns()
            times = reference.times(begin_ns, end_ns)
        # controllers first, while the HLI can still take their lease back
        launcher.stop_service("follower")
        launcher.stop_service("leader")
    spent = {name: after[name] - before[name] for name in before}
    woken = {name: woken_after[name] - woken_before[name] for name in woken_before}
    return _Window(begin_ns, end_ns, spent, woken, times, reference_after - reference_before, stolen_share)


def _counted(
    launcher: Launcher, wait: Callable[[float], None], count: Callable[[int], float]
) -> dict[str, float]:
    """Counts of each process so far, by its id."""
    try:
        return {name: count(child.pid) for name, child in launcher.children.items()}
    except ProcessLookupError:
        wait(_END_TOLD_S)  # raises an error that names the ended service
        raise


def _wait(
    launcher: Launcher, lines: LastLines, began_s: float, on_time: Callable[[float], None], for_s: float
) -> None:
    end_s = time.monotonic() + for_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        on_time(time.monotonic() - began_s)
        match launcher.wait(min(_TICK_S, left_s)):
            case Interrupted(number):
                raise LaunchInterruptedError(f"stopped by {number.name} while the cell was measured")
            case Exited(name, status):
                raise LaunchError(
                    f"{describe_exit(name, status)} while the cell was measured; the last lines were\n{lines.text()}"
                )


def _figures(
    cell: CellDescription,
    services: Sequence[Service],
    window: _Window,
    bare: BareChain,
    written: Sequence[WrittenStamps],
) -> LiveRun:
    ahead = cell.gate.lookahead_cycles
    stamps = by_robot(written)
    robots = {
        name: robot_figures(
            stamps.get(name, RobotStamps()), window.begin_ns, window.end_ns, window.reference, ahead
        )
        for name in cell.robots
    }
    cycles = (window.end_ns - window.begin_ns) / 1e9 / cell.cycle_s
    processor_us = {name: spent_s / cycles * 1e6 for name, spent_s in window.processor_s.items()}
    reference_us = window.reference_processor_s / cycles * 1e6
    reference = window.reference
    woken = {name: count / cycles for name, count in window.wakeups.items()}
    stamping = [service for service in services if service.role in STAMPING]
    return LiveRun(
        robots=robots,
        processor_us=processor_us,
        wakeups=woken,
        bare=bare,
        reference={
            "cycles": len(reference.rows),
            "in_time": reference.in_time,
            "processor_us": reference_us,
        },
        rows=(
            *bounded_rows(robots, processor_us, reference, reference_us, window.stolen_share),
            *bare_rows(robots, processor_us, woken, bare),
        ),
        silent=_silent(stamping, {one.process for one in written}),
        overwritten=sum(one.overwritten for one in written),
    )


def _silent(stamping: Sequence[Service], heard: set[str]) -> tuple[str, ...]:
    """Services without stamps; a controller's carry the name of its robot, so they are counted."""
    silent = [
        service.name
        for service in stamping
        if service.role not in (Role.LEADER, Role.FOLLOWER) and service.name not in heard
    ]
    controllers = [service.name for service in stamping if service.role in (Role.LEADER, Role.FOLLOWER)]
    clients = sum(name.startswith("client-") for name in heard)
    return (*silent, *controllers[clients:])
