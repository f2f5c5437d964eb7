"""A run as one self-contained HTML page: no address outside it, no script, every text escaped."""

import contextlib
import math
from html import escape
from pathlib import Path

from deltaq_experiments.run_report import drawing
from deltaq_experiments.run_report.figures import begun_at
from deltaq_experiments.run_report.run import ReasonGroup, RecordedRun, RobotRun, RunEventKind
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Outcome, Phase
from deltaq_protocol.reasons import EXPLANATIONS
from deltaq_testing.report_page import Cells, document, table

_EVENTS_TOLD = 200
_LIMITS_TOLD = 3
_NEAR_LIMIT = 0.05
"""Share of its range within which a joint is near a limit."""
_SIGNS = {
    RunEventKind.STOP: "✖",
    RunEventKind.HOLD: "■",
    RunEventKind.RESET: "▲",
    RunEventKind.FAULT: "▼",
    RunEventKind.GAP: "◆",
    RunEventKind.NOTE: "●",
}


def page(run: RecordedRun) -> str:
    """The whole page."""
    title = f"{run.path.name} — cell {run.about.get('cell', '?')}"
    parts = [
        f"<h1>{escape(run.path.name)}</h1>",
        f'<p class="soft">{escape(_subject(run))}</p>',
        *(f'<p class="note">{escape(notice)}</p>' for notice in run.notices),
        _summary(run),
        "<h2>What happened</h2>",
        _timeline(run),
        _events(run),
        _clearance(run),
        "<h2>The gate</h2>",
        *(_gate(robot) for robot in run.robots.values()),
        "<h2>Cycles</h2>",
        _cycles(run),
        "<h2>Joints and their limits</h2>",
        *(_joints(robot, run.length_s) for robot in run.robots.values() if robot.time_s.size),
        "<h2>The recording</h2>",
        _recording(run),
    ]
    return document(title, parts)


def _subject(run: RecordedRun) -> str:
    began = begun_at(run)
    when = f"begun {began}" if began else "in virtual time"
    return f"Cell {run.about.get('cell', '?')}, {len(run.robots)} robots, {when}, {run.length_s:.1f} s"


def _summary(run: RecordedRun) -> str:
    robots = run.robots.values()
    verdicts = sum(sum(robot.outcomes.values()) for robot in robots)
    admitted = sum(robot.outcomes[Outcome.ADMITTED] for robot in robots)
    counts = {kind: sum(event.kind is kind for event in run.events) for kind in RunEventKind}
    tiles = [
        (
            "admitted as requested",
            _percent(admitted / verdicts if verdicts else None),
            f"of {verdicts} verdicts",
        ),
        *(_rate_tile(robot) for robot in robots),
        (
            "stops and holds",
            str(counts[RunEventKind.STOP] + counts[RunEventKind.HOLD]),
            f"{counts[RunEventKind.FAULT]} faults",
        ),
        _least_tile(run),
    ]
    shown = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(more)}</small></dd></div>"
        for name, value, more in tiles
    )
    return f'<dl class="summary">{shown}</dl>'


def _rate_tile(robot: RobotRun) -> tuple[str, str, str]:
    told = (
        (_percent(robot.admission_rate), "of its cycles while driven")
        if robot.outcomes
        else ("–", "not driven")
    )
    return f"admission rate, {robot.name}", *told


def _least_tile(run: RecordedRun) -> tuple[str, str, str]:
    found = [robot.least_clearance for robot in run.robots.values() if robot.least_clearance]
    if run.least is not None:
        nearest, at = run.least
        found = [(nearest.distance_m, nearest.pair, at)]
    if not found:
        return "least clearance", "–", "not recorded"
    distance_m, pair, at = min(found)
    return "least clearance", f"{1000 * distance_m:.0f} mm", f"{' and '.join(pair or ())} at {at:.2f} s"


def _timeline(run: RecordedRun) -> str:
    bands = "".join(
        f'<span><i style="background:var(--{phase.value})"></i>{phase.value}</span>'
        for phase in (Phase.READY, Phase.ENGAGED, Phase.BRAKING, Phase.HELD, Phase.OFFLINE)
    )
    signs = "".join(f"<span>{sign} {kind.value}</span>" for kind, sign in _SIGNS.items())
    key = f'<figcaption class="key">{bands}{signs}<span>| the gate bound an increment</span></figcaption>'
    return f'<figure class="wide">{drawing.timeline(run)}{key}</figure>'


def _events(run: RecordedRun) -> str:
    if not run.events:
        return "<p>No stop, hold, reset or fault was recorded.</p>"
    rows = [
        (f"{event.time_s:.2f}", f"{_SIGNS[event.kind]} {event.kind.value}", event.robot or "all",
         _often(event.text, event.count))
        for event in run.events[:_EVENTS_TOLD]
    ]  # fmt: skip
    more = len(run.events) - len(rows)
    rest = f'<p class="soft">and {more} more events</p>' if more else ""
    return table(("time [s]", "event", "robot", "what"), rows, numbers={0}) + rest


def _often(text: str, count: int) -> str:
    return f"{text}, {count} times" if count > 1 else text


def _clearance(run: RecordedRun) -> str:
    drawn = drawing.clearance(run)
    if drawn is None:
        return "<h2>Clearance</h2><p>The recording has no distances.</p>"
    told = (
        "The distance of the two nearest bodies of the cell."
        if run.nearest
        else "Of each verdict: the distance of the two bodies that are nearest to their stop distance along the "
        "certified path."
    )
    return f'<h2>Clearance</h2><figure class="wide">{drawn}<figcaption>{told}</figcaption></figure>'


def _gate(robot: RobotRun) -> str:
    counts = ", ".join(
        f"{count} {outcome.value}" for outcome, count in sorted(robot.outcomes.items()) if count
    )
    head = f"<h3>{escape(robot.name)}</h3><p>{escape(counts) or 'No increment was asked for.'}</p>"
    groups = sorted(robot.reasons.values(), key=lambda group: -group.count)
    if not groups:
        return head
    columns = ("outcome", "reason", "verdicts", "from [s]", "to [s]", "on")
    return head + table(columns, [_reason_row(group) for group in groups], numbers={2, 3, 4})


def _reason_row(group: ReasonGroup) -> Cells:
    reason = "no reason given" if group.code is None else f"{group.code.value}: {EXPLANATIONS[group.code]}"
    told = group.limits.most_common(_LIMITS_TOLD)
    limits = ", ".join(_often(what, count) for what, count in told)
    if len(group.limits) > len(told):
        limits += f" and {len(group.limits) - len(told)} more"
    return (
        group.outcome.value, reason, str(group.count), f"{group.first_s:.2f}", f"{group.last_s:.2f}", limits,
    )  # fmt: skip


def _cycles(run: RecordedRun) -> str:
    rows = []
    for robot in run.robots.values():
        intervals = robot.intervals_s
        times = ["–"] * 3 if intervals is None else [f"{1000 * interval:.2f}" for interval in intervals]
        counters = ", ".join(f"{name} {count}" for name, count in sorted(robot.counters.items())) or "none"
        rate = _percent(robot.admission_rate if robot.outcomes else None)
        counted = [str(count) for count in (robot.time_s.size, robot.missed_cycles, robot.restarts)]
        rows.append((robot.name, *counted, rate, *times, counters))
    columns = (
        "robot", "cycles", "missed", "restarts", "admission rate", "median [ms]", "99 % [ms]", "longest [ms]",
        "counted by its Robot Server",
    )  # fmt: skip
    told = (
        f"A cycle is {1000 * run.cycle_s:g} ms. The times are those between two states, as the recorder saw them. "
        "The admission rate is the share of cycles in which a fresh, admitted increment reached the robot, "
        "from the first such cycle to the last."
    )
    return table(columns, rows, numbers=set(range(1, 8))) + f'<p class="soft">{told}</p>'


def _joints(robot: RobotRun, length_s: float) -> str:
    summary, q = robot.summary, robot.q
    rows = []
    columns = zip(
        summary.joints, summary.units, summary.lower, summary.upper, q.T, robot.fastest.tolist(), strict=True
    )
    for name, unit, lower, upper, values, fastest in columns:
        least, greatest = float(values.min()), float(values.max())
        margin = min(least - lower, upper - greatest)
        is_near = margin < _NEAR_LIMIT * (upper - lower)
        rows.append(
            (name, _span(lower, upper, unit), _span(least, greatest, unit),
             f"{'▲ ' if is_near else ''}{_amount(margin, unit)}", _percent(fastest))
        )  # fmt: skip
    columns_told = ("joint", "limits", "travelled", "left to a limit", "greatest speed, of its limit")
    return (
        f'<h3>{escape(robot.name)}</h3><figure class="wide">{drawing.joints(robot, length_s)}</figure>'
        + table(columns_told, rows, numbers={1, 2, 3, 4})
    )


def _recording(run: RecordedRun) -> str:
    facts = [
        ("file", str(run.path)),
        ("SHA-256", run.sha256),
        ("cell", run.about.get("identity", "") or run.about.get("cell", "")),
        ("gate", ", ".join(run.gates) or "no fingerprint was recorded"),
        ("source", run.about.get("source", "")),
        ("protocol", run.about.get("protocol", "")),
    ]
    shown = "".join(f"<dt>{name}</dt><dd><code>{escape(value)}</code></dd>" for name, value in facts)
    told = "Two runs with the same fingerprint of the gate passed the same code with the same configuration."
    return f'<dl class="facts">{shown}</dl><p class="soft">{told}</p>'


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f} %"


def _amount(value: float, unit: str) -> str:
    # no minus before a zero
    return (
        f"{round(math.degrees(value), 1) + 0.0:.1f}°"
        if unit == "rad"
        else f"{round(1000 * value, 0) + 0.0:.0f} mm"
    )


def _span(lower: float, upper: float, unit: str) -> str:
    return f"{_amount(lower, unit)} to {_amount(upper, unit)}"


def must_be_free(file: Path) -> None:
    """Check the place of a report before a long recording is read for it.

    Raises:
        DeltaqError: there is a file already, or no folder for it.
    """
    if file.exists():
        raise DeltaqError(f"{file} exists already; it is not overwritten, name another file with --output")
    if not file.parent.is_dir():
        raise DeltaqError(f"{file} cannot be written: there is no folder {file.parent}")


def write(file: Path, text: str) -> None:
    """Write a report.

    Raises:
        DeltaqError: there is a file already, or it cannot be written.
    """
    must_be_free(file)
    begun = False
    try:
        with file.open("x", encoding="utf-8") as output:
            begun = True
            output.write(text)
    except OSError as error:
        if begun:
            with contextlib.suppress(OSError):  # half a report would pass for a whole one
                file.unlink()
        raise DeltaqError(f"{file} cannot be written: {error.strerror}") from error
