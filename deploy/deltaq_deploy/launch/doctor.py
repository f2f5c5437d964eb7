"""How fit this machine is to run a cell: the checks of `deltaq doctor`."""

from __future__ import annotations

import importlib
import os
import platform
import sys
import time
from importlib.metadata import PackageNotFoundError, version

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.errors import LaunchError
from deltaq_deploy.launch.findings import DoctorFinding, Rating
from deltaq_deploy.launch.launcher import check_ports
from deltaq_deploy.launch.rates import percentile
from deltaq_deploy.launch.real_time import examine_real_time
from deltaq_deploy.launch.services import cell_services, console_service

NAPS = 100
NAP_S = 0.001
PACKAGES = ("deltaq", "eclipse-zenoh", "msgpack", "numpy", "pydantic", "pin", "coal", "typer", "rich")
BINDINGS = ("pinocchio", "coal")


def examine(cell: CellDescription, cell_name: str) -> list[DoctorFinding]:
    """Check this machine for one cell."""
    return [
        _python(),
        _cores(),
        *examine_real_time(),
        _clock(cell.cycle_s),
        *_ports(cell, cell_name),
        *_packages(),
        *_bindings(),
    ]


def _python() -> DoctorFinding:
    fit = sys.version_info >= (3, 11)
    return DoctorFinding(
        "Python",
        platform.python_version(),
        Rating.GOOD if fit else Rating.BAD,
        "" if fit else "3.11 or newer",
    )


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
        "clock", found, Rating.FAIR, f"a cycle is {cycle_s * 1e6:.0f} us: find out what else runs here"
    )


def _ports(cell: CellDescription, cell_name: str) -> list[DoctorFinding]:
    findings = []
    for service in (*cell_services(cell, cell_name), console_service(cell, cell_name, ())):
        ports = ", ".join(f"{listener.transport} {listener.port}" for listener in service.listens)
        try:
            check_ports([service])
        except LaunchError as error:
            findings.append(DoctorFinding(f"ports of {service.name}", ports, Rating.BAD, str(error)))
        else:
            findings.append(DoctorFinding(f"ports of {service.name}", f"{ports} free", Rating.GOOD))
    return findings


def _packages() -> list[DoctorFinding]:
    findings = []
    for package in PACKAGES:
        try:
            findings.append(DoctorFinding(package, version(package), Rating.GOOD))
        except PackageNotFoundError:
            findings.append(DoctorFinding(package, "missing", Rating.BAD, "pip install 'deltaq[all]'"))
    return findings


def _bindings() -> list[DoctorFinding]:
    findings = []
    for module in BINDINGS:
        try:
            importlib.import_module(module)
        except ImportError as error:
            advice = "install the library named (libgomp1 on Debian and Ubuntu), or pip install 'deltaq[all]'"
            findings.append(DoctorFinding(f"import {module}", str(error), Rating.BAD, advice))
        else:
            findings.append(DoctorFinding(f"import {module}", "works", Rating.GOOD))
    return findings
