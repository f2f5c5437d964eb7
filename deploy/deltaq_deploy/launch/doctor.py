"""The checks of `deltaq doctor`: whether this machine is fit to run a cell."""

import importlib
import os
import platform
import resource
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.launcher import check_ports
from deltaq_deploy.launch.program import LaunchError
from deltaq_deploy.launch.rates import percentile
from deltaq_deploy.launch.services import Service, cell_services, console_service
from deltaq_protocol.real_time import SchedulingPriority


class Rating(StrEnum):
    """Good; works but not at its best; will not work."""

    GOOD = "good"
    FAIR = "fair"
    BAD = "bad"


@dataclass(frozen=True)
class DoctorFinding:
    """One check; advice is empty where nothing needs to be done."""

    what: str
    found: str
    verdict: Rating
    advice: str = ""


ASKED = max(SchedulingPriority)
"""The highest priority of SCHED_FIFO that a service asks for."""
_THROTTLE_US = Path("/proc/sys/kernel/sched_rt_runtime_us")
_PERIOD_US = Path("/proc/sys/kernel/sched_rt_period_us")


def examine_real_time() -> list[DoctorFinding]:
    """Ask for real-time priority as a service does, and check that real-time services cannot starve the machine."""
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    return [
        judge_priority(_is_given(ASKED), limit),
        judge_throttling(_number(_THROTTLE_US), _number(_PERIOD_US)),
    ]


def judge_priority(given: bool, limit: int) -> DoctorFinding:
    """Result of asking for real-time priority.

    Args:
        given: whether the kernel gave the priority.
        limit: RLIMIT_RTPRIO of this user, -1 for none.
    """
    what, asked = "real-time priority", f"asked for SCHED_FIFO {ASKED}"
    bound = "unlimited" if limit == resource.RLIM_INFINITY else str(limit)
    if given:
        return DoctorFinding(what, f"{asked}: given (RLIMIT_RTPRIO {bound})", Rating.GOOD)
    return DoctorFinding(
        what,
        f"{asked}: refused (RLIMIT_RTPRIO {bound}); services run as SCHED_OTHER",
        Rating.FAIR,
        f"write `@realtime - rtprio {ASKED}` into /etc/security/limits.d/realtime.conf, join the group realtime and "
        "log in again; in a container, --cap-add SYS_NICE",
    )


def judge_throttling(runtime_us: int | None, period_us: int | None) -> DoctorFinding:
    """Whether the kernel reserves a fraction of the time for programs without real-time priority.

    Args:
        runtime_us: time of a period that they may take, -1 for all of it; None if the kernel does not say [us].
        period_us: the period [us].
    """
    what = "real-time throttling"
    if runtime_us is None or not period_us:
        return DoctorFinding(
            what, "this kernel does not say", Rating.FAIR, "see sched_rt_runtime_us of your kernel"
        )
    if 0 <= runtime_us < period_us:
        return DoctorFinding(
            what, f"real-time processes get {runtime_us / period_us:.0%} at most", Rating.GOOD
        )
    return DoctorFinding(
        what,
        "off: a real-time process that never waits keeps its core for ever",
        Rating.FAIR,
        "sysctl -w kernel.sched_rt_runtime_us=950000 leaves 5 % to other programs",
    )


def _is_given(priority: int) -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


def _number(file: Path) -> int | None:
    with suppress(OSError, ValueError):
        return int(file.read_text(encoding="ascii"))
    return None


NAPS = 100
NAP_S = 0.001
PACKAGES = ("deltaq", "eclipse-zenoh", "msgpack", "numpy", "pydantic", "pin", "coal", "typer", "rich")
BINDINGS = ("pinocchio", "coal")


def examine(cell: CellDescription, cell_name: str) -> list[DoctorFinding]:
    """Check this machine for one cell."""
    services = (*cell_services(cell, cell_name), console_service(cell, cell_name, ()))
    machine = [_python(), _cores(), *examine_real_time(), _clock(cell.cycle_s)]
    return [*machine, *map(_ports, services), *map(_package, PACKAGES), *map(_binding, BINDINGS)]


def _python() -> DoctorFinding:
    fit = sys.version_info >= (3, 11)
    found = platform.python_version()
    return DoctorFinding("Python", found, *((Rating.GOOD,) if fit else (Rating.BAD, "3.11 or newer")))


def _cores() -> DoctorFinding:
    cores = len(os.sched_getaffinity(0))
    if cores >= 4:
        return DoctorFinding("cores", str(cores), Rating.GOOD)
    return DoctorFinding(
        "cores", str(cores), Rating.FAIR, "a service each wants a core of its own; 4 are comfortable"
    )


def _clock(cycle_s: float) -> DoctorFinding:
    late = []
    for _ in range(NAPS):
        begin = time.monotonic()
        time.sleep(NAP_S)
        late.append(time.monotonic() - begin - NAP_S)
    late.sort()
    p99 = percentile(late, 0.99)
    found = f"wakes up {percentile(late, 0.5) * 1e6:.0f} us late, p99 {p99 * 1e6:.0f} us"
    if p99 < cycle_s / 4:
        return DoctorFinding("clock", found, Rating.GOOD)
    return DoctorFinding(
        "clock", found, Rating.FAIR, f"a cycle is {cycle_s * 1e6:.0f} us: end other programs"
    )


def _ports(service: Service) -> DoctorFinding:
    what = f"ports of {service.name}"
    ports = ", ".join(f"{listener.transport} {listener.port}" for listener in service.listens)
    try:
        check_ports([service])
    except LaunchError as error:
        return DoctorFinding(what, ports, Rating.BAD, str(error))
    return DoctorFinding(what, f"{ports} free", Rating.GOOD)


def _package(name: str) -> DoctorFinding:
    try:
        return DoctorFinding(name, version(name), Rating.GOOD)
    except PackageNotFoundError:
        return DoctorFinding(name, "missing", Rating.BAD, "pip install 'deltaq[all]'")


def _binding(module: str) -> DoctorFinding:
    try:
        importlib.import_module(module)
    except ImportError as error:
        advice = "install the library named (libgomp1 on Debian and Ubuntu), or pip install 'deltaq[all]'"
        return DoctorFinding(f"import {module}", str(error), Rating.BAD, advice)
    return DoctorFinding(f"import {module}", "works", Rating.GOOD)
