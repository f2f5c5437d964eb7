"""The console's recordings: which there are, which may be opened, and the one that is being written.

Only files that lie in the folder itself are listed and opened: no path, no link, no other ending.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from deltaq_services.console.commands import Record
from deltaq_services.console.messages import RecordingView
from deltaq_services.console.outputs import ToRecorder

ENDING = ".mcap"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap")
_MOST_LISTED = 500


class NoSuchRecordingError(ValueError):
    """A name that is not the name of a recording in the folder."""


class RecordingFolder:
    """A folder of recordings.

    Args:
        path: of the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def listed(self) -> list[dict[str, Any]]:
        """Its recordings, newest first: name, length [bytes], and when it was written last [s since 1970]."""
        try:
            found = [(file, file.stat()) for file in self.path.iterdir() if self._is_recording(file)]
        except OSError:
            return []
        found.sort(key=lambda pair: -pair[1].st_mtime)
        return [
            {"name": file.name, "bytes": about.st_size, "written_s": about.st_mtime}
            for file, about in found[:_MOST_LISTED]
        ]

    def file(self, name: str) -> Path:
        """The file of a recording.

        Raises:
            NoSuchRecordingError: the folder has no recording of that name.
        """
        file = self.path / name
        if not _NAME.fullmatch(name) or not self._is_recording(file):
            raise NoSuchRecordingError(f"name: the folder has no recording {name[:80]!r}")
        return file

    @staticmethod
    def _is_recording(file: Path) -> bool:
        return _NAME.fullmatch(file.name) is not None and not file.is_symlink() and file.is_file()


class RecordingDesk:
    """The recording that is being written, and what became of the last.

    Args:
        cell: name of the cell.
        has_folder: whether the console was given a folder for recordings.
    """

    def __init__(self, cell: str, has_folder: bool) -> None:
        self._cell, self._has_folder = cell, has_folder
        self._view = RecordingView()

    @property
    def view(self) -> RecordingView | None:
        """The status for browsers; None without a folder."""
        return self._view if self._has_folder else None

    def handle(self, command: Record, now_s: float) -> ToRecorder:
        """Begin or end a recording, or raise `ValueError` with the reason why not."""
        if not self._has_folder:
            raise ValueError(
                "the console was given no folder for recordings; start it with --recordings FOLDER"
            )
        if command.action == "stop":
            if not self._view.file:
                raise ValueError("action: nothing is being recorded")
            return ToRecorder(None)
        if self._view.file:
            raise ValueError(f"action: {self._view.file} is being recorded already")
        asked = datetime.fromtimestamp(now_s, UTC)
        self._view = RecordingView(file=f"{self._cell}-{asked:%Y%m%d-%H%M%S}{ENDING}")
        return ToRecorder(self._view.file)

    def began(self, now_s: float) -> None:
        """The recorder writes."""
        if self._view.file:
            self._view = RecordingView(file=self._view.file, since_s=now_s)

    def ended(self, why: str) -> str:
        """The recorder has ended, and why if not as asked; returns what to tell."""
        text = f"{self._view.file} was recorded" if not why else f"{self._view.file}: {why}"
        self._view = RecordingView(text=text)
        return text
