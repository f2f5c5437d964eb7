"""Writes reports, over those of the run before."""

from __future__ import annotations

import os
from pathlib import Path

from deltaq_testing.scenario.file import ScenarioError


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
