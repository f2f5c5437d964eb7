"""The recorder as a process: a recording begins and ends with it. Were this console to be killed, it would end too."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import Callable
from pathlib import Path

from deltaq_protocol.log import message_of

_ENDS_WITHIN_S = 10.0
_LONGEST_TOLD = 300
_READY = "ready:"


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
