"""The console's recordings: the folder that has them, and the processes that write one and read one.

Only files that lie in the folder itself are listed and opened: no path, no link, no other ending.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltaq_protocol.log import message_of

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.mcap")
_MOST_LISTED = 500
_ENDS_WITHIN_S, _READ_WITHIN_S = 10.0, 300.0
_LONGEST_TOLD = 300
_READY = "ready:"


class NoSuchRecordingError(ValueError):
    """A name that is not the name of a recording in the folder."""


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
        self._process: Process | None = None
        self._running: asyncio.Task[None] | None = None
        self._is_wanted = False

    def start(self, file: Path) -> None:
        """Write a recording."""
        self._is_wanted = True
        self._running = asyncio.ensure_future(self._run(file))

    def stop(self) -> None:
        """Complete the recording."""
        self._is_wanted = False
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    async def end(self) -> None:
        """Complete the recording, if one is written, and wait for it."""
        if self._running is None or self._running.done():
            return
        self.stop()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(self._running), _ENDS_WITHIN_S)
            return
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
        await self._running

    async def _run(self, file: Path) -> None:
        command = (
            "-m",
            "deltaq_services.recorder",
            "--cell",
            self._cell,
            "--file",
            str(file),
            "--until-input-ends",
        )
        try:
            self._process = process = await asyncio.create_subprocess_exec(
                sys.executable, *command, stdin=PIPE, stdout=PIPE, stderr=STDOUT, start_new_session=True
            )
            assert process.stdin is not None  # pipes were asked for
            assert process.stdout is not None
            if not self._is_wanted:
                process.stdin.close()
            has_begun, last = False, ""
            async for line in process.stdout:
                last = message_of(line.decode(errors="replace").strip()) or last
                if last.startswith(_READY) and not has_begun:
                    has_begun = True
                    self._began()
            status = await process.wait()
            if status == 0 and not self._is_wanted:
                why = "" if has_begun else "it was ended before anything was written"
            else:
                why = (
                    last.removeprefix("error: ")[:_LONGEST_TOLD] or f"the recorder ended with status {status}"
                )
        except OSError as error:
            why = str(error)
        self._process = None
        self._ended(why)


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
