"""Processes that the console starts and speaks to in lines, and the one that drives a robot for an operator.

A driver holds the lease and answers the robot's cycle by itself. Were this console to be killed, its input would end:
it brings the robot to rest, releases it and ends.
"""

import asyncio
import contextlib
import os
import sys
from asyncio.subprocess import PIPE, STDOUT, Process
from collections.abc import Callable, Mapping

from pydantic import ValidationError

from deltaq_protocol import driving
from deltaq_protocol.given_token import CLIENT_TOKEN

_ENDS_WITHIN_S = 3.0
_MOST_WAITING_BYTES = 64 * 1024
_LONGEST_LINE_BYTES = 64 * 1024


class ConsoleProgram:
    """A running Python process, which ends when its input ends.

    Args:
        said: called with each line that it writes.
        ended: called with its exit status, or with why it could not be started.
        ends_within_s: time that it is given to end by itself [s].
        environment: of the process; None for this one's.
        tells_errors: lines of its standard error are passed to `said`, too.
    """

    def __init__(
        self,
        said: Callable[[bytes], None],
        ended: Callable[[int | str], None],
        ends_within_s: float,
        environment: Mapping[str, str] | None = None,
        tells_errors: bool = False,
    ) -> None:
        self._said, self._ended, self._ends_within_s = said, ended, ends_within_s
        self._environment, self._stderr = environment, STDOUT if tells_errors else None
        self._process: Process | None = None
        self._running: asyncio.Task[None] | None = None
        self._waiting: list[bytes] = []
        self._is_closed = False

    @property
    def is_running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._running is not None

    def start(self, *arguments: str) -> None:
        """Start it, with these arguments for Python."""
        self._is_closed = False
        self._running = asyncio.ensure_future(self._run(arguments))

    def write(self, line: bytes) -> None:
        """Write to its input, at once or when it is there."""
        if self._process is None:
            self._waiting.append(line)
            return
        assert self._process.stdin is not None  # a pipe was asked for
        if self._process.stdin.transport.get_write_buffer_size() > _MOST_WAITING_BYTES:
            self._process.kill()  # it does not listen: it must not move a robot either
            return
        with contextlib.suppress(ConnectionError):
            self._process.stdin.write(line + b"\n")

    def close(self) -> None:
        """End its input."""
        self._is_closed = True
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()

    async def end(self) -> None:
        """Let it end, and wait for that."""
        if self._running is None:
            return
        self.close()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(self._running), self._ends_within_s)
            return
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
        await self._running

    async def _run(self, arguments: tuple[str, ...]) -> None:
        status: int | str
        try:
            # a session of its own: Ctrl-C on the terminal is for the launcher, which ends its services in order
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                *arguments,
                stdin=PIPE,
                stdout=PIPE,
                stderr=self._stderr,
                limit=_LONGEST_LINE_BYTES,
                start_new_session=True,
                env=self._environment,
            )
            self._process = process
            waiting, self._waiting = self._waiting, []
            for line in waiting:
                self.write(line)
            if self._is_closed:
                self.close()
            await self._listen(process)
            status = await process.wait()
        except OSError as error:
            status = str(error)
        self._process = self._running = None
        self._waiting.clear()
        self._ended(status)

    async def _listen(self, process: Process) -> None:
        assert process.stdout is not None  # a pipe was asked for
        while True:
            try:
                line = await process.stdout.readline()
            except ValueError:  # longer than any line that is for the console
                continue
            if not line:
                return
            self._said(line)


class DriverProcess:
    """The driver of one robot, which is started when it is first needed.

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
        environment = {**os.environ, CLIENT_TOKEN: token, f"{CLIENT_TOKEN}_FILE": ""} if token else None
        self._said, self._ended = said, ended
        self._child = ConsoleProgram(self._take, self._has_ended, _ENDS_WITHIN_S, environment)

    def send(self, request: driving.DriverRequest) -> None:
        """Ask it for something; it is started if it does not run."""
        if not self._child.is_running:
            if request.id is None:
                return  # no robot moves
            self._child.start(*self._command)
        self._child.write(request.model_dump_json().encode())

    async def end(self) -> None:
        """Let the robot come to rest and the process end."""
        await self._child.end()

    def _take(self, line: bytes) -> None:
        with contextlib.suppress(ValidationError):  # a library's word, no line of the driver's
            self._said(driving.SAID.validate_json(line))

    def _has_ended(self, status: int | str) -> None:
        if isinstance(status, str):
            self._ended(status)
        else:
            self._ended(f"exit status {status}" if status >= 0 else f"signal {-status}")
