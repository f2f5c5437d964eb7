"""Writes a report where nothing was before."""

from __future__ import annotations

import contextlib
from pathlib import Path

from deltaq_protocol.errors import DeltaqError


class ReportError(DeltaqError):
    """A report that cannot be written."""


def must_be_free(file: Path) -> None:
    """Check the place of a report before a long recording is read for it.

    Raises:
        ReportError: there is a file already, or no folder for it.
    """
    if file.exists():
        raise ReportError(f"{file} exists already; it is not overwritten, name another file with --output")
    if not file.parent.is_dir():
        raise ReportError(f"{file} cannot be written: there is no folder {file.parent}")


def write(file: Path, text: str) -> None:
    """Write a report.

    Raises:
        ReportError: there is a file already, or it cannot be written.
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
        raise ReportError(f"{file} cannot be written: {error.strerror}") from error
