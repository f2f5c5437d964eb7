"""The page of testing controllers: fixtures, what a test does and asks, faults, and the fields of a scenario."""

import inspect
from collections.abc import Callable, Iterator
from typing import Any

from deltaq_testing import plugin, schedule, strategies
from deltaq_testing.observed import JointTrackingError, Observed
from deltaq_testing.scenario.model import (
    EndsAt,
    Expectations,
    FaultEntry,
    FaultSearch,
    Scenario,
    Tracking,
)
from deltaq_testing.virtual import CellUnderTest
from reference_pages.markdown import fields, table

_INTRODUCTION = (
    "Look up fixtures, checks, faults and the fields of a scenario. [Find the bug in a controller]"
    "(../tutorial/find-the-bug.md) is the tutorial, [test a controller of your own](../how-to/test-a-controller.md) the"
    " guide. The extra is `deltaq[testing]`, the import package `deltaq_testing`."
)
_SECTIONS = ("Args", "Returns", "Raises", "Attributes")


def testing() -> str:
    """The whole page."""
    faults = ((f"`{row.name}`", row.what) for row in schedule.VIRTUAL)
    models = (Scenario, FaultEntry, Expectations, EndsAt, Tracking, FaultSearch)
    return "\n\n".join(
        [
            "# Testing controllers",
            _INTRODUCTION,
            "## Fixtures",
            table(("fixture", "what it is"), _fixtures()),
            f"Marker: `{plugin.MARKER}`. Options of pytest: `--deltaq-cell`, `--deltaq-seed`.",
            "## The cell under test",
            table(("member", "action or result"), [*_members(CellUnderTest), *_members(Observed)]),
            table(("attribute", "content"), [*_attributes(CellUnderTest), *_attributes(Observed)]),
            "A `RunFinding` is true if the check holds; `told` gives the reason.",
            f"A `JointTrackingError` has `max`, `rms` and `final`: {_text(JointTrackingError)}",
            "## Faults",
            _documented(schedule.fault, "deltaq_testing.schedule"),
            "Two faults that change the same process, clock or link cannot overlap.",
            table(("fault", "what happens"), faults),
            "## Schedules for hypothesis",
            _documented(strategies.schedules, "deltaq_testing.strategies"),
            "## Scenario files",
            *(fields(model, 3) for model in models),
        ]
    )


def _fixtures() -> Iterator[tuple[str, str]]:
    for name, value in vars(plugin).items():
        wrapped = getattr(value, "__wrapped__", None)
        if wrapped is not None and type(value).__name__ == "FixtureFunctionDefinition":
            yield f"`{name}`", _text(wrapped)


def _members(of: type) -> Iterator[tuple[str, str]]:
    """Public methods and properties that a class itself has, in the order of its source."""
    for name, value in vars(of).items():
        if name.startswith("_"):
            continue
        if isinstance(value, property):
            yield f"`{name}`", _text(value)
        elif inspect.isfunction(value):
            yield f"`{name}{_signature(value)}`", _text(value)


def _signature(function: Callable[..., Any]) -> str:
    """What it is called with, without types."""
    parameters = [
        one.replace(annotation=inspect.Parameter.empty)
        for name, one in inspect.signature(function).parameters.items()
        if name != "self"
    ]
    return str(inspect.Signature(parameters))


def _attributes(of: type) -> Iterator[tuple[str, str]]:
    return _entries(of, "Attributes")


def _documented(function: Callable[..., Any], module: str) -> str:
    """A function with its arguments."""
    name = function.__name__
    head = f"`from {module} import {name}`; `{name}{_signature(function)}`. {_text(function)}"
    return f"{head}\n\n{table(('argument', 'what it is'), _entries(function, 'Args'))}"


def _entries(of: object, section: str) -> Iterator[tuple[str, str]]:
    """Names and texts of a section of a docstring."""
    text = (inspect.getdoc(of) or "").partition(f"{section}:\n")[2].partition("\n\n")[0]
    for line in text.replace("\n        ", " ").splitlines():
        name, _, told = line.strip().partition(": ")
        yield f"`{name}`", told


def _text(of: object) -> str:
    """What a docstring says before its first section, on one line."""
    text = inspect.getdoc(of) or ""
    for section in _SECTIONS:
        text = text.partition(f"\n{section}:")[0]
    return " ".join(text.split())
