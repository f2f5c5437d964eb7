"""Reports of scenarios: HTML pages, and JUnit XML."""

import re
from collections.abc import Iterable, Sequence
from html import escape
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Phase
from deltaq_testing.report_page import COLOURS, document, inlined, outline, settings, table
from deltaq_testing.scenario.model import dumped
from deltaq_testing.scenario.run import ScenarioOutcome
from deltaq_testing.virtual import CellUnderTest

_SIZE_IN = (9.4, 2.6)
_STYLES = ("-", "--", ":", "-.")


def html_page(outcomes: Sequence[ScenarioOutcome]) -> str:
    """One HTML page that shows each outcome: expectations, events and a plot of the joints."""
    failed = sum(not outcome.good for outcome in outcomes)
    tiles = (("scenarios", len(outcomes)), ("failed", failed))
    summary = "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles)
    rows = [
        (outcome.name, _mark(outcome.good), str(outcome.cell.seed), f"{outcome.cell.time_s:.2f}")
        for outcome in outcomes
    ]
    parts = ["<h1>Faults</h1>", f'<dl class="summary">{summary}</dl>']
    parts.append(table(("scenario", "result", "seed", "length [s]"), rows, numbers={2, 3}))
    for number, outcome in enumerate(outcomes):
        parts += _parts(outcome, number)
    return document("Faults", parts)


def _parts(outcome: ScenarioOutcome, number: int) -> list[str]:
    cell = outcome.cell
    checks = [(_mark(bool(check.finding)), check.what, check.finding.told) for check in outcome.checks]
    events = [(f"{time_s:.3f}", what) for time_s, what in cell.events]
    return [
        f"<h2>{escape(outcome.name)}</h2>",
        f'<p class="soft">Cell {escape(cell.model.description.cell)}, robot {escape(cell.robot)}, seed {cell.seed}</p>',
        table(("", "expected", "found"), checks),
        f'<figure class="wide">{_figure(cell, number)}<figcaption>Joints of {escape(cell.robot)} from home, in degrees '
        "and centimetres. Shaded: a fault stands; darker: the robot is held.</figcaption></figure>",
        table(("time [s]", "what happened"), events, numbers={0}) if events else "<p>Nothing happened.</p>",
        f"<details><summary>The scenario</summary><pre><code>{escape(dumped(outcome.scenario))}</code></pre></details>",
    ]


def _mark(good: bool) -> str:
    return "✔ yes" if good else "✖ no"


def _figure(cell: CellUnderTest, number: int) -> str:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    robot, history = cell.model.robots[cell.robot], cell.history[cell.robot]
    moved: Array = np.array(history.q[cell.ready_row :]) - cell.home
    time_s: Array = np.arange(len(moved), dtype=np.float64) * cell.cycle_s
    scale: Array = np.where(robot.revolute, 180.0 / np.pi, 100.0)
    with mpl.rc_context(settings(f"scenario {number}")):
        figure = Figure(figsize=_SIZE_IN, layout="constrained")
        axes = figure.subplots()
        for begin_s, end_s in cell.fault_times_s:
            axes.axvspan(begin_s, min(end_s, time_s[-1]), color=COLOURS["braking"], alpha=0.25, linewidth=0)
        held = np.array([phase is Phase.HELD for phase in history.phases[cell.ready_row :]])
        for begin, end in _spans(held):
            axes.axvspan(time_s[begin], time_s[end], color=COLOURS["held"], alpha=0.25, linewidth=0)
        for joint, name in enumerate(robot.joint_names):
            at, drawn = outline(time_s, moved[:, joint] * scale[joint])
            colour = COLOURS["line" if joint % 2 else "second"]
            axes.plot(at, drawn, _STYLES[joint // 2 % 4], color=colour, linewidth=1.2, label=name)
        axes.set_xlabel("time [s]")
        axes.grid(axis="y", linewidth=0.5)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.legend(fontsize=8, frameon=False, ncols=5)
        return inlined(figure, f"Joints of {escape(cell.robot, quote=True)} over time")


def _spans(rows: Array) -> list[tuple[int, int]]:
    """First and last row of each run of true ones."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], rows.astype(int), [0]))))
    return [(int(first), int(end) - 1) for first, end in list(pairwise(edges))[::2]]


_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd]")
"""Characters that XML 1.0 cannot have."""


def junit_xml(outcomes: Iterable[ScenarioOutcome]) -> str:
    """A JUnit XML document: each scenario is a suite, each expectation a case."""
    suites = ET.Element("testsuites", name="deltaq fault run")
    for outcome in outcomes:
        failures = sum(not check.finding for check in outcome.checks)
        suite = ET.SubElement(
            suites,
            "testsuite",
            name=_clean(outcome.name),
            tests=str(len(outcome.checks)),
            failures=str(failures),
            errors="0",
            time=f"{outcome.wall_s:.3f}",
        )
        properties = ET.SubElement(suite, "properties")
        cell = outcome.cell
        for name, value in (
            ("cell", cell.model.description.cell),
            ("robot", cell.robot),
            ("seed", str(cell.seed)),
        ):
            ET.SubElement(properties, "property", name=name, value=_clean(value))
        for check in outcome.checks:
            case = ET.SubElement(suite, "testcase", classname=_clean(outcome.name), name=check.what, time="0")
            if not check.finding:
                ET.SubElement(case, "failure", message=_clean(check.finding.told)).text = _clean(
                    cell.account()
                )
        ET.SubElement(suite, "system-out").text = _clean(cell.account())
    ET.indent(suites)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(suites, encoding="unicode") + "\n"


def _clean(text: str) -> str:
    return _NO_XML.sub("?", text)
