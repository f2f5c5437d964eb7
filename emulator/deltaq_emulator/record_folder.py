"""The folder in which whoever reaches the emulator's panel may write records: new files there, and nothing else.

Any process on the machine reaches the panel. So it names a file and no path, no file is written over, no link is
followed, and there is an end to how many there are and how long they get.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TextIO

from deltaq_protocol.errors import DeltaqError

MOST_RECORDS = 100
"""Files that the panel of one process writes."""
MOST_ROWS = 1_000_000
"""Cycles in each: more than three hours at 12 ms, and some 300 MB of an arm with six joints."""
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}")


class RecordError(DeltaqError):
    """A recording file that cannot be written."""


class RecordFolder:
    """A folder that was there when the emulator started; it stays the same one, whatever becomes of its path.

    Args:
        path: of the folder.

    Raises:
        RecordError: if there is no such folder, or a link stands for it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._begun = 0
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError as error:
            raise RecordError(f"--records {path}: is no folder ({error.strerror}); make it first") from error

    def close(self) -> None:
        """Let go of the folder."""
        os.close(self._descriptor)

    def new_file(self, name: str) -> TextIO:
        """Make a file of this name.

        Raises:
            RecordError: if it is the name of no file, the file is there already, or it cannot be made.
        """
        if not _NAME.fullmatch(name):
            raise RecordError(
                f"path: {name[:100]!r} is no name of a file in {self.path}; give one of at most 100 letters, digits, "
                "'_', '-' and '.', without a folder"
            )
        if self._begun >= MOST_RECORDS:
            raise RecordError(
                f"{MOST_RECORDS} records were begun, and no more are allowed; start the emulator again"
            )
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
        try:
            descriptor = os.open(name, flags, 0o644, dir_fd=self._descriptor)
        except FileExistsError:
            raise RecordError(
                f"path: {self.path / name} exists already; no file is overwritten, give another name"
            ) from None
        except OSError as error:
            raise RecordError(f"path: {self.path / name} cannot be written: {error.strerror}") from error
        self._begun += 1
        return os.fdopen(descriptor, "w", encoding="utf-8", buffering=1, newline="")
