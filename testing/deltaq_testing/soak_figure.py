"""A soak as a picture: latency and memory over time, and when which fault befell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from deltaq_testing.soak import SoakReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
