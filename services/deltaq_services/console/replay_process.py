"""Reads a recording for a browser, in a process of its own: the web server never waits for it. One at a time."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from asyncio.subprocess import PIPE
from pathlib import Path

_READ_WITHIN_S = 300.0


class UnreadableError(Exception):
    """The recording could not be read; the text says why."""


class BusyError(Exception):
    """Another recording is being read."""


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
