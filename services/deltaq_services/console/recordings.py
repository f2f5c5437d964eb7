"""The console's recordings: the folder that has them, and the processes that write one and read one.

Only files that lie in the folder itself are listed and opened: no path, no link, no other ending.
"""

import asyncio
import contextlib
import re
import sys
from asyncio.subprocess import PIPE
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltaq_protocol.log import message_of
from deltaq_services.console.driver_process import ConsoleProgram
from deltaq_services.video_stream import pictures_of

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap")
_PICTURE = re.compile(r"[a-z][a-z0-9_.-]{0,80}-[0-9]{7}\.jpg")
_MOST_LISTED = 500
_ENDS_WITHIN_S, _READ_WITHIN_S = 10.0, 300.0
_LONGEST_TOLD = 300
_READY = "ready:"


class NoSuchRecordingError(ValueError):
    """The folder has no recording of that name."""


class UnreadableError(Exception):
    """The recording could not be read; the text says why."""


class BusyError(Exception):
    """Another recording is being read."""


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

    def picture(self, name: str, picture: str) -> Path:
        """A picture that a recording refers to; raises as `file` does."""
        file = pictures_of(self.file(name)) / picture
        if not _PICTURE.fullmatch(picture) or file.is_symlink() or not file.is_file():
            raise NoSuchRecordingError(f"picture: recording {name[:80]!r} has no picture {picture[:80]!r}")
        return file

    @staticmethod
    def _is_recording(file: Path) -> bool:
        return _NAME.fullmatch(file.name) is not None and not file.is_symlink() and file.is_file()


class RecorderProcess:
    """The recorder, while it writes.

    Args:
        cell: name or file of the cell.
        began: called when it writes.
        ended: called when it has ended, with why if it was not asked to.
    """

    def __init__(self, cell: str, began: Callable[[], None], ended: Callable[[str], None]) -> None:
        self._cell, self._began, self._ended = cell, began, ended
        self._child = ConsoleProgram(self._said, self._has_ended, _ENDS_WITHIN_S, tells_errors=True)
        self._has_begun = self._is_wanted = False
        self._last = ""

    def start(self, file: Path) -> None:
        """Write a recording."""
        self._is_wanted, self._has_begun, self._last = True, False, ""
        where = ("--cell", self._cell, "--file", str(file))
        self._child.start("-m", "deltaq_services.recorder", *where, "--until-input-ends")

    def stop(self) -> None:
        """Complete the recording."""
        self._is_wanted = False
        self._child.close()

    async def end(self) -> None:
        """Complete the recording, if one is written, and wait for it."""
        self._is_wanted = False
        await self._child.end()

    def _said(self, line: bytes) -> None:
        self._last = message_of(line.decode(errors="replace").strip()) or self._last
        if self._last.startswith(_READY) and not self._has_begun:
            self._has_begun = True
            self._began()

    def _has_ended(self, status: int | str) -> None:
        if status == 0 and not self._is_wanted:
            self._ended("" if self._has_begun else "it was ended before anything was written")
        elif isinstance(status, str):
            self._ended(status)
        else:
            why = self._last.removeprefix("error: ")[:_LONGEST_TOLD]
            self._ended(why or f"the recorder ended with status {status}")


class ReplayReader:
    """Reads recordings of one cell.

    Args:
        identity: of the cell in whose scene they are shown.
    """

    def __init__(self, identity: str) -> None:
        self._identity = identity
        self._is_reading = False

    async def read(self, file: Path) -> bytes:
        """The recording as JSON.

        Raises:
            BusyError: another one is being read.
            UnreadableError: the file is not a recording of this cell, or reading it takes too long.
        """
        if self._is_reading:
            raise BusyError("another recording is being read; try again in a moment")
        self._is_reading = True
        try:
            return await self._read(file)
        finally:
            self._is_reading = False

    async def _read(self, file: Path) -> bytes:
        command = ("-m", "deltaq_services.recorder.replayed", str(file), "--identity", self._identity)
        process = await asyncio.create_subprocess_exec(
            sys.executable, *command, stdout=PIPE, stderr=PIPE, start_new_session=True
        )
        try:
            document, said = await asyncio.wait_for(process.communicate(), _READ_WITHIN_S)
        except TimeoutError:
            raise UnreadableError(f"{file.name} could not be read within {_READ_WITHIN_S:g} s") from None
        finally:
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
        if process.returncode:
            lines = said.decode(errors="replace").strip().splitlines() or ["it could not be read"]
            raise UnreadableError(lines[-1].removeprefix("error: ").replace(str(file), file.name))
        return document
