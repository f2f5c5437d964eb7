"""How fit this machine is to run a cell: the checks of `deltaq doctor`."""

from __future__ import annotations

import importlib
import os
import platform
import sys
import time
from importlib.metadata import PackageNotFoundError, version

from deltaq_cell.description import CellDescription
from deltaq_launch.findings import Finding, Verdict
from deltaq_launch.launcher import LaunchError, check_ports
from deltaq_launch.rates import percentile
from deltaq_launch.real_time import examine_real_time
from deltaq_launch.services import cell_services

NAPS = 100
NAP_S = 0.001
PACKAGES = ("deltaq", "eclipse-zenoh", "msgpack", "numpy", "pydantic", "pin", "coal", "typer", "rich")
BINDINGS = ("pinocchio", "coal")


def examine(cell: CellDescription, cell_name: str) -> list[Finding]:
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
