"""The process that drives one robot for an operator: started when it is first needed, spoken to in lines.

It holds the lease and answers the robot's cycle by itself. Were this console to be killed, its input would end: it
brings the robot to rest, releases it and ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable

from pydantic import ValidationError

from deltaq_protocol import driving
from deltaq_protocol.given_token import CLIENT_TOKEN

_ENDS_WITHIN_S = 3.0
_MOST_WAITING_BYTES = 64 * 1024
_LONGEST_LINE_BYTES = 64 * 1024


class DriverProcess:
    """The driver of one robot.

    Args:
        hli: address of the HLI.
        robot: its name.
        said: called with each line that it says.
        ended: called with why it has ended, when it has.
        token: shows its role to the HLI; None if it needs to show none.
    """

    def __init__(
        self,
        hli: str,
        robot: str,
        said: Callable[[driving.DriverMessage], None],
        ended: Callable[[str], None],
        token: str | None,
    ) -> None:
        self._command = ("-m", "deltaq_controllers.operated", "--url", hli, "--robot", robot)
        self._environment = {**os.environ, CLIENT_TOKEN: token, f"{CLIENT_TOKEN}_FILE": ""} if token else None
        self._said, self._ended = said, ended
        self._process: Process | None = None
        self._running: asyncio.Task[None] | None = None
        self._waiting: list[driving.DriverRequest] = []

    def send(self, request: driving.DriverRequest) -> None:
        """Ask it for something; it is started if it does not run."""
        if self._running is None:
            if request.id is None:
                return  # nobody moves
            self._running = asyncio.ensure_future(self._run())
        if self._process is None:
            self._waiting.append(request)
        else:
            self._write(self._process, request)

    async def end(self) -> None:
        """Let the robot come to rest and the process end."""
        if self._running is None:
            return
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(self._running), _ENDS_WITHIN_S)
            return
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
        await self._running

    async def _run(self) -> None:
        try:
            # a session of its own: Ctrl-C on the terminal is for the launcher, which ends its services in order
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                *self._command,
                stdin=PIPE,
                stdout=PIPE,
                limit=_LONGEST_LINE_BYTES,
                start_new_session=True,
                env=self._environment,
            )
            self._process = process
            waiting, self._waiting = self._waiting, []
            for request in waiting:
                self._write(process, request)
            await self._listen(process)
            status = await process.wait()
            why = f"exit status {status}" if status >= 0 else f"signal {-status}"
        except OSError as error:
            why = str(error)
        self._process = self._running = None
        self._waiting.clear()
        self._ended(why)

    async def _listen(self, process: Process) -> None:
        assert process.stdout is not None  # a pipe was asked for
        while True:
            try:
                line = await process.stdout.readline()
            except ValueError:  # longer than any of its lines
                continue
            if not line:
                return
            with contextlib.suppress(ValidationError):  # a library's word, no line of the driver's
                self._said(driving.SAID.validate_json(line))

    def _write(self, process: Process, request: driving.DriverRequest) -> None:
        assert process.stdin is not None  # a pipe was asked for
        if process.stdin.transport.get_write_buffer_size() > _MOST_WAITING_BYTES:
            process.kill()  # it does not listen: it must not move the robot either
            return
        with contextlib.suppress(ConnectionError):
            process.stdin.write(request.model_dump_json().encode() + b"\n")
