"""The figures of a report: the run as a timeline, clearance, and each joint between its limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from deltaq_experiments.run_report.run import RecordedRun, RobotRun, RunEventKind
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Phase
from deltaq_testing.report_page import COLOURS, inlined, outline, settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 9.4
_LEFT_IN, _RIGHT_IN = 0.75, 0.15
COLUMNS = 600
"""Of the timeline."""
_WORST_FIRST = (Phase.HELD, Phase.OFFLINE, Phase.BRAKING, Phase.ENGAGED, Phase.READY)
MARKS = {
    RunEventKind.STOP: "X",
    RunEventKind.HOLD: "s",
    RunEventKind.RESET: "^",
    RunEventKind.FAULT: "v",
    RunEventKind.GAP: "D",
    RunEventKind.NOTE: "o",
}
"""Of events in the timeline, each a shape of its own."""


def timeline(run: RecordedRun) -> str:
    """Phases, verdicts that bound, and events of each robot over time."""
    import matplotlib as mpl

    with mpl.rc_context(settings("timeline")):
        count = len(run.robots)
        figure, (axes,) = _figure(1, 0.45 + 0.62 * count)
        for row, robot in enumerate(run.robots.values()):
            _phases(axes, robot, run.length_s, float(row))
            bound_s = _seen(robot.bound_s, run.length_s)
            axes.plot(
                bound_s,
                np.full(len(bound_s), row + 0.33),
                "|",
                color=COLOURS["text"],
                markersize=5,
                alpha=0.7,
            )
        for row, name in enumerate((*run.robots, "")):
            for kind, mark in MARKS.items():
                at = _seen(
                    [event.time_s for event in run.events if event.kind is kind and event.robot == name],
                    run.length_s,
                )
                heights = np.full(len(at), row - 0.34 if name else -0.75)
                axes.plot(
                    at, heights, mark, color=COLOURS["text"], markersize=5.5, markeredgewidth=0, clip_on=False
                )
        axes.set_ylim(count - 0.5, -0.9)
        axes.set_yticks(range(count), list(run.robots))
        axes.tick_params(axis="y", length=0, labelcolor=COLOURS["text"])
        _time_axis(axes, run.length_s)
        return inlined(figure, "Phases and events over time")


def clearance(run: RecordedRun) -> str | None:
    """The clearance over time, with the stop distances; None where the recording has none."""
    import matplotlib as mpl

    curves = [(robot.name, robot.clearance) for robot in run.robots.values() if robot.clearance.size]
    if run.nearest:
        curves = [("nearest pair of the cell", np.array(run.nearest))]
    if not curves:
        return None
    gate = run.cell.description.gate
    with mpl.rc_context(settings("clearance")):
        figure, (axes,) = _figure(1, 1.9)
        for (name, curve), colour, style in zip(
            curves, ("line", "second", "text"), ("-", "--", ":"), strict=False
        ):
            at, distance_m = outline(curve[:, 0], curve[:, 1])
            axes.plot(at, 1000.0 * distance_m, style, color=COLOURS[colour], linewidth=1.1, label=name)
        for bound_m, text, dashes in (
            (gate.stop_distance_m, "stop distance", (4, 2)),
            (gate.self_stop_distance_m, "of a robot's own bodies", (1, 2)),
        ):
            axes.axhline(
                1000.0 * bound_m, color=COLOURS["held"], linewidth=1.0, linestyle=(0, dashes), label=text
            )
        axes.set_ylim(0.0, 1.25 * axes.get_ylim()[1])  # room for the legend
        axes.set_ylabel("clearance [mm]")
        axes.grid(axis="y", linewidth=0.5)
        axes.legend(fontsize=8, frameon=False, loc="upper left", ncols=5)
        _time_axis(axes, run.length_s)
        return inlined(figure, "Clearance over time")


def joints(robot: RobotRun, length_s: float) -> str:
    """Each joint over time, drawn from its lower limit to its upper one."""
    import matplotlib as mpl

    summary, time_s, q = robot.summary, robot.time_s, robot.q
    with mpl.rc_context(settings(f"joints {robot.name}")):
        figure, rows = _figure(len(summary.joints), 0.44 * len(summary.joints))
        columns = zip(rows, summary.joints, summary.units, summary.lower, summary.upper, q.T, strict=True)
        for axes, name, unit, lower, upper, values in columns:
            scale = math.degrees(1.0) if unit == "rad" else 1000.0
            axes.axhspan(lower * scale, upper * scale, color=COLOURS["ready"], alpha=0.16, linewidth=0)
            at, drawn = outline(time_s, values * scale)
            axes.plot(at, drawn, color=COLOURS["line"], linewidth=1.2)
            reach = 0.06 * (upper - lower) * scale
            axes.set_ylim(lower * scale - reach, upper * scale + reach)
            axes.set_yticks([lower * scale, upper * scale])
            axes.yaxis.set_major_formatter(
                lambda value, _, unit=unit: f"{value:.0f}{'°' if unit == 'rad' else ''}"
            )
            axes.tick_params(axis="y", labelsize=6.5, length=0)
            axes.set_ylabel(name, rotation=0, ha="right", va="center", color=COLOURS["text"])
            axes.yaxis.set_label_coords(-0.045, 0.5)
            _time_axis(axes, length_s, is_last=axes is rows[-1])
        return inlined(figure, f"Joints of {escape(robot.name, quote=True)} between their limits")


def _figure(rows: int, height_in: float) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    below_in, above_in = 0.46, 0.1
    whole_in = height_in + below_in + above_in
    figure = Figure(figsize=(WIDTH_IN, whole_in))
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    figure.subplots_adjust(
        left=_LEFT_IN / WIDTH_IN, right=1.0 - _RIGHT_IN / WIDTH_IN,
        bottom=below_in / whole_in, top=1.0 - above_in / whole_in, hspace=0.3,
    )  # fmt: skip
    return figure, axes


def _time_axis(axes: Axes, length_s: float, is_last: bool = True) -> None:
    # a recording of one moment has a width too
    axes.set_xlim(0.0, max(length_s, 1e-3))
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_visible(is_last)
    if is_last:
        axes.set_xlabel("time [s]")
    else:
        axes.tick_params(axis="x", length=0)


def _seen(times_s: Sequence[float], length_s: float) -> Array:
    """Times of which no two fall into one column of the timeline [s]."""
    times = np.asarray(times_s, dtype=float)
    columns = np.floor(COLUMNS * times / max(length_s, 1e-3))
    return times[np.unique(columns, return_index=True)[1]]


def _phases(axes: Axes, robot: RobotRun, length_s: float, row: float) -> None:
    """Bands of the phases; where several fall into one column, the worst of them."""
    if not robot.phases:
        return
    changes_s = np.array([time_s for time_s, _, _ in robot.phases])
    severity = np.array([_WORST_FIRST.index(phase) for _, phase, _ in robot.phases])
    edges_s = np.linspace(changes_s[0], max(length_s, 1e-3), COLUMNS + 1)
    first = np.searchsorted(changes_s, edges_s[:-1], side="right") - 1
    last = np.searchsorted(changes_s, edges_s[1:], side="left")
    shown = np.array([severity[a : max(b, a + 1)].min() for a, b in zip(first, last, strict=True)])
    starts = np.flatnonzero(np.diff(shown, prepend=-1))
    for start, end in zip(starts, (*starts[1:], COLUMNS), strict=True):
        phase = _WORST_FIRST[shown[start]]
        width = edges_s[end] - edges_s[start]
        axes.broken_barh(
            [(edges_s[start], width)], (row - 0.18, 0.36), facecolor=COLOURS[phase.value], linewidth=0,
            hatch="////" if phase is Phase.HELD else None, edgecolor=COLOURS["text"] if phase is Phase.HELD else None,
        )  # fmt: skip
