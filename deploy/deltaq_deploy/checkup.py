"""How fit this machine is to run a cell: what `deltaq doctor` looks at."""

from __future__ import annotations

import importlib
import os
import platform
import resource
import shutil
import sys
import time
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version

from deltaq_cell.description import CellDescription
from deltaq_deploy.launcher import LaunchError, check_ports
from deltaq_deploy.rates import percentile
from deltaq_deploy.services import cell_services

NAPS = 100
NAP_S = 0.001
PACKAGES = ("deltaq", "eclipse-zenoh", "msgpack", "numpy", "pydantic", "pin", "coal", "typer", "rich")
BINDINGS = ("pinocchio", "coal")


class Verdict(StrEnum):
    """Good; works but not at its best; will not work."""

    GOOD = "good"
    FAIR = "fair"
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at; advice is empty where nothing needs to be done."""

    what: str
    found: str
    verdict: Verdict
    advice: str = ""


def examine(cell: CellDescription, cell_name: str) -> list[Finding]:
    """Look at this machine with the eyes of one cell."""
    return [
        _python(),
        _cores(),
        _real_time(),
        _clock(cell.cycle_s),
        _setpriv(),
        *_ports(cell, cell_name),
        *_packages(),
        *_bindings(),
    ]


def _python() -> Finding:
    fit = sys.version_info >= (3, 11)
    return Finding(
        "Python",
        platform.python_version(),
        Verdict.GOOD if fit else Verdict.BAD,
        "" if fit else "3.11 or newer",
    )


def _cores() -> Finding:
    cores = len(os.sched_getaffinity(0))
    if cores >= 4:
        return Finding("cores", str(cores), Verdict.GOOD)
    return Finding(
        "cores", str(cores), Verdict.FAIR, "a service each wants a core of its own; 4 are comfortable"
    )


def _real_time() -> Finding:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        return Finding(
            "real-time priority",
            f"not allowed (rtprio limit {limit})",
            Verdict.FAIR,
            "allow it with an rtprio line in /etc/security/limits.d, or --cap-add SYS_NICE",
        )
    os.sched_setscheduler(0, *before)
    return Finding("real-time priority", "allowed", Verdict.GOOD)


def _clock(cycle_s: float) -> Finding:
    late = []
    for _ in range(NAPS):
        begin = time.monotonic()
        time.sleep(NAP_S)
        late.append(time.monotonic() - begin - NAP_S)
    late.sort()
    p99 = percentile(late, 0.99)
    found = f"wakes up {percentile(late, 0.5) * 1e6:.0f} us late, p99 {p99 * 1e6:.0f} us"
    if p99 < cycle_s / 4:
        return Finding("clock", found, Verdict.GOOD)
    return Finding(
        "clock", found, Verdict.FAIR, f"a cycle is {cycle_s * 1e6:.0f} us: find out what else runs here"
    )


def _setpriv() -> Finding:
    path = shutil.which("setpriv")
    if path:
        return Finding("setpriv", path, Verdict.GOOD)
    return Finding(
        "setpriv",
        "missing",
        Verdict.FAIR,
        "install util-linux: services then end even if `deltaq up` is killed",
    )


def _ports(cell: CellDescription, cell_name: str) -> list[Finding]:
    findings = []
    for service in cell_services(cell, cell_name):
        ports = ", ".join(f"{listener.transport} {listener.port}" for listener in service.listens)
        try:
            check_ports([service])
        except LaunchError as error:
            findings.append(Finding(f"ports of {service.name}", ports, Verdict.BAD, str(error)))
        else:
            findings.append(Finding(f"ports of {service.name}", f"{ports} free", Verdict.GOOD))
    return findings


def _packages() -> list[Finding]:
    findings = []
    for package in PACKAGES:
        try:
            findings.append(Finding(package, version(package), Verdict.GOOD))
        except PackageNotFoundError:
            findings.append(Finding(package, "missing", Verdict.BAD, "pip install 'deltaq[all]'"))
    return findings


def _bindings() -> list[Finding]:
    findings = []
    for module in BINDINGS:
        try:
            importlib.import_module(module)
        except ImportError as error:
            advice = "install the library named (libgomp1 on Debian and Ubuntu), or pip install 'deltaq[all]'"
            findings.append(Finding(f"import {module}", str(error), Verdict.BAD, advice))
        else:
            findings.append(Finding(f"import {module}", "works", Verdict.GOOD))
    return findings
