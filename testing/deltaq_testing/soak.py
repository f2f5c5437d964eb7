"""A soak: fault after fault against a cell of real processes, for hours, with memory and latency watched."""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.catalogue import CATALOGUE
from deltaq_testing.live import CLIENT, LiveCell, applies_live, live_cell
from deltaq_testing.schedule import TimedFault

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ROUND_S = 6.0
"""A round: a fault begins in its first half, and has ended when it does."""
_EVERY_S = 1.0


class SoakSample(BaseModel, frozen=True):
    """A moment.

    Attributes:
        time_s: since the soak began.
        memory_mb: resident, by process.
        latency_ms: from a question to the gate, over the HLI, to its answer; None where none came.
    """

    time_s: float
    memory_mb: dict[str, float]
    latency_ms: float | None


class SoakRound(BaseModel, frozen=True):
    """A fault and its effect.

    Attributes:
        time_s: when the round began.
        recovered: whether the robots could move again.
        clear, limits: findings of the independent checker.
        good: whether all checks passed.
    """

    time_s: float
    fault: str
    at_s: float
    for_s: float
    recovered: bool
    clear: str
    limits: str
    good: bool


class SoakReport(BaseModel):
    """The report of a soak; `interrupted` if Ctrl-C ended it early."""

    cell: str
    robot: str
    seed: int
    asked_s: float
    length_s: float = 0.0
    interrupted: bool = False
    samples: list[SoakSample] = []
    rounds: list[SoakRound] = []

    @property
    def good(self) -> bool:
        """Whether every round was, and there was one."""
        return bool(self.rounds) and all(one.good for one in self.rounds)


def run_soak(
    folder: Path,
    cell: str,
    robot: str | None,
    duration_s: float,
    seed: int,
    on_round: Callable[[SoakRound], None] = lambda _: None,
) -> SoakReport:
    """Inject fault after fault while a robot moves; Ctrl-C ends it with the report so far.

    Args:
        folder: for the files of the cell.
        cell: name or file of a cell whose robots are driven over RSI.
        robot: the moving robot; None for the first.
        duration_s: no round begins later [s].
        seed: of the faults and their times.
        on_round: called after each round.

    Raises:
        DeltaqError: as `live_cell` does.
    """
    draw = random.Random(seed)
    with live_cell(folder, cell, robot) as live:
        report = SoakReport(cell=live.model.description.cell, robot=live.robot, seed=seed, asked_s=duration_s)
        mover = "deltaq_testing.faults.mover"
        live.drive_process([sys.executable, "-m", mover, "{port}", live.robot, f"{live.home[0]}"])
        began_s = time.monotonic()
        try:
            while time.monotonic() - began_s < duration_s:
                report.rounds.append(_round(live, report, draw, began_s))
                on_round(report.rounds[-1])
        except KeyboardInterrupt:
            report.interrupted = True
        report.length_s = time.monotonic() - began_s
    return report


def _round(live: LiveCell, report: SoakReport, draw: random.Random, began_s: float) -> SoakRound:
    fault = draw.choice([row for row in CATALOGUE if applies_live(row)])
    timed = TimedFault(fault, round(draw.uniform(1.0, ROUND_S / 2), 3), round(draw.uniform(0.2, 1.5), 3))
    live.begin()
    time_s = time.monotonic() - began_s
    live.suffer(timed)
    while live.time_s < ROUND_S:
        live.run(min(_EVERY_S, max(ROUND_S - live.time_s, 0.01)))
        report.samples.append(_sample(live, time.monotonic() - began_s))
    clear, limits, recovered = live.kept_clear(), live.kept_limits(), live.recover()
    return SoakRound(
        time_s=time_s,
        fault=fault.name,
        at_s=timed.at_s,
        for_s=timed.for_s,
        recovered=recovered,
        clear=clear.told,
        limits=limits.told,
        good=bool(clear) and bool(limits) and recovered,
    )


def _sample(live: LiveCell, time_s: float) -> SoakSample:
    latency_ms = None
    with suppress(DeltaqError), connect(live.model.description, CLIENT) as cell:
        asked_s = time.perf_counter()
        cell.dry_run(live.robot, [0.0] * len(live.home))
        latency_ms = 1000.0 * (time.perf_counter() - asked_s)
    memory = {name: used for name, pid in live.pids.items() if (used := _memory_mb(pid)) is not None}
    return SoakSample(time_s=time_s, memory_mb=memory, latency_ms=latency_ms)


def _memory_mb(pid: int) -> float | None:
    """Resident memory; None of a process that has ended."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
    return None


def figure_of(report: SoakReport) -> Figure:
    """Two panels with one time axis; rounds that were not good are marked."""
    from matplotlib.figure import Figure

    scale, unit = (3600.0, "h") if report.length_s > 7200 else (60.0, "min")
    figure = Figure(figsize=(9.4, 5.6), layout="constrained")
    axes: Any = figure.subplots(2, 1, sharex=True)
    latency, memory = axes
    told = [sample for sample in report.samples if sample.latency_ms is not None]
    times = [sample.time_s / scale for sample in told]
    latency.plot(times, [sample.latency_ms for sample in told], ".", markersize=2.5)
    latency.set_ylabel("question to the gate\nto its answer [ms]")
    for name in sorted({name for sample in report.samples for name in sample.memory_mb}):
        seen = [sample for sample in report.samples if name in sample.memory_mb]
        memory.plot(
            [sample.time_s / scale for sample in seen],
            [sample.memory_mb[name] for sample in seen],
            linewidth=1.0,
            label=name,
        )
    memory.set_ylabel("resident memory [MB]")
    memory.set_xlabel(f"time [{unit}]")
    memory.set_ylim(bottom=0.0)
    if report.samples:
        memory.legend(fontsize=8, frameon=False, ncols=4)
    for one in report.rounds:
        if not one.good:
            for axis in axes:
                axis.axvline(one.time_s / scale, color="tab:red", linewidth=0.8)
    bad = sum(not one.good for one in report.rounds)
    figure.suptitle(
        f"cell {report.cell}, seed {report.seed}: {len(report.rounds)} faults, {bad} of them not good"
    )
    return figure
