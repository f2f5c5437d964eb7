"""Outcomes as JUnit XML, which every CI reads: a suite a scenario, a case an expectation."""

from __future__ import annotations

import re
from collections.abc import Iterable
from xml.etree import ElementTree as ET

from deltaq_testing.scenario.run import ScenarioOutcome

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd]")
"""Characters that XML 1.0 cannot have."""


def junit_xml(outcomes: Iterable[ScenarioOutcome]) -> str:
    """The document."""
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
