"""Reads scenario files, with errors that name file, line, field, value and bound; and writes them."""

import json
import os
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from deltaq_cell.load import problem_of
from deltaq_cell.problems import Problem
from deltaq_cell.yaml_tree import MAX_BYTES, parse
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.scenario.model import Scenario


class ScenarioError(DeltaqError):
    """A scenario that cannot be run, with all that is wrong with its file."""


def load_scenario(file: Path) -> Scenario:
    """Read a scenario.

    Raises:
        ScenarioError: it cannot be read, or has errors; each is a line.
        CellError: it is no YAML.
    """
    try:
        with file.open("rb") as stream:
            text = stream.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise ScenarioError(f"{file}: must be {MAX_BYTES} bytes or less")
        return parse_scenario(text.decode("utf-8-sig"), file.name)
    except OSError as error:
        raise ScenarioError(f"{file}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{file}: is not UTF-8 text; save it as UTF-8") from None


def parse_scenario(text: str, source: str) -> Scenario:
    """The scenario in a YAML text; `source` names it in messages. Raises as `load_scenario` does."""
    tree = parse(text, source)
    if not isinstance(tree.value, dict):
        raise ScenarioError(f"{source}: must be a mapping with the fields controller and duration_s")
    try:
        # as JSON, because strict validation takes JSON's lists for tuples but no text for numbers
        return Scenario.model_validate_json(json.dumps(tree.plain()), strict=True)
    except ValidationError as error:
        problems: list[Problem] = [problem_of(tree, dict(item), Scenario) for item in error.errors()]
        raise ScenarioError("\n".join(map(str, problems))) from None


def dumped(scenario: Scenario) -> str:
    """A scenario as a YAML text, without default values."""
    fields: dict[str, Any] = scenario.model_dump(mode="json", exclude_defaults=True)
    return yaml.safe_dump(fields, sort_keys=False, allow_unicode=True)


def must_be_folder(folder: Path) -> None:
    """Make a folder for reports, before a long run is begun for them.

    Raises:
        ScenarioError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"{folder}: is no folder for reports: {error.strerror}") from None


def write_report(file: Path, text: str) -> None:
    """Write a report in place of an older one; never half of it.

    Raises:
        ScenarioError: it cannot be written.
    """
    part = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(file)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ScenarioError(f"{file}: cannot be written: {error.strerror}") from None
