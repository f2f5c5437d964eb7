"""Everything that a service counts is explained, and nothing is explained that nobody counts."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import deltaq_services
from deltaq_services.counters import CONSOLE, COUNTERS, HLI, ROBOT_SERVER, SIM

SERVICES = Path(deltaq_services.__path__[0])
COUNTED_BY_VARIABLE = {
    "decision.outcome": "{outcome}",
    "Outcome.REFUSED": "{outcome}",
    "why": "{refusal}",
    "who": "{sender}",
}
"""Counters whose whole name is in a variable, and their rows."""


def counted(source: str) -> Iterator[str]:
    """Names of the counters that a program has, each variable part as `{}`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Subscript) and ast.unparse(node.value).endswith("counters"):
            yield name_of(node.slice)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "Counter":
            yield from (name_of(made.key) for made in node.args if isinstance(made, ast.DictComp))


def name_of(key: ast.expr) -> str:
    if isinstance(key, ast.Constant):
        return str(key.value)
    if isinstance(key, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in key.values)
    return without_names(COUNTED_BY_VARIABLE.get(ast.unparse(key), f"a variable: {ast.unparse(key)}"))


def without_names(template: str) -> str:
    return re.sub(r"\{\w+\}", "{}", template)


@pytest.mark.parametrize("service", [HLI, SIM, ROBOT_SERVER, CONSOLE])
def test_what_a_service_counts_has_a_row_and_every_row_is_counted(service: str) -> None:
    sources = [file.read_text() for file in (SERVICES / service).glob("*.py")]
    in_code = {name for source in sources for name in counted(source)}
    in_table = {without_names(row.name) for row in COUNTERS if row.service == service}
    assert in_code == in_table, "see deltaq_services/counters.py"


def test_a_counter_that_is_new_is_found_however_it_is_named() -> None:
    source = 'self.counters["new"] += 1\nx._counters[f"new_{a}"] += 1\ncore.counters[other] += 1'
    assert set(counted(source)) == {"new", "new_{}", "a variable: other"}


def test_no_row_is_written_twice_and_each_says_something() -> None:
    rows = [(row.service, row.name) for row in COUNTERS]
    assert len(rows) == len(set(rows))
    assert all(len(row.meaning.split()) > 2 for row in COUNTERS)
