"""Child processes of the launcher, in sessions of their own, with their output read line by line."""

import asyncio
import contextlib
import os
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deltaq_protocol.log import message_of

READY = "ready:"
"""Beginning of the line that a service prints once it serves."""

KEPT_LINES = 200

NICENESS = -10
"""Services run ahead of ordinary programs where the system allows it: a cycle does not wait. Those between a
controller and the motors ask for real-time priority themselves, however they are started. The console shows and asks,
and so do its drivers, which inherit its priority: it runs as an ordinary program does."""


@dataclass(frozen=True)
class Ready:
    """A child has reported that it is ready."""

    name: str
    line: str


@dataclass(frozen=True)
class Exited:
    """A child ended; a negative status is the signal that ended it."""

    name: str
    status: int


class Lifeline:
    """A pipe to one process: the kernel sends it SIGTERM once no process holds the writing end.

    Attributes:
        writer: the writing end; held by the launcher, its warden, and all services that must end before the process.
    """

    def __init__(self) -> None:
        self.reader, self.writer = os.pipe()

    def end_with(self, pid: int) -> None:
        """Have that process, which has inherited the reading end, sent the signal; give up the reading end here."""
        import fcntl  # not on Windows, where commands in virtual time are compiled, too

        fcntl.fcntl(self.reader, fcntl.F_SETSIG, signal.SIGTERM)
        fcntl.fcntl(self.reader, fcntl.F_SETOWN, pid)
        fcntl.fcntl(self.reader, fcntl.F_SETFL, fcntl.fcntl(self.reader, fcntl.F_GETFL) | os.O_ASYNC)
        os.close(self.reader)

    def close(self) -> None:
        """Give up the writing end here."""
        os.close(self.writer)


def start_with_lines(
    command: Sequence[str],
    environment: Mapping[str, str] | None = None,
    pass_fds: Sequence[int] = (),
) -> subprocess.Popen[str]:
    """Start a process in a session of its own; its output can be read line by line.

    Args:
        command: program and arguments.
        environment: variables in addition to this process's own.
        pass_fds: descriptors that it inherits.
    """
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        pass_fds=pass_fds,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})},
        encoding="utf-8",
        errors="replace",
    )


class Child:
    """A running child process.

    It is the leader of its own session, so Ctrl-C on the terminal reaches the launcher alone, which then ends
    its children in order. Should the launcher itself be killed, its warden does; should both be, its lifeline does.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        on_event: Callable[[Ready | Exited], None],
        on_line: Callable[[str, str], None],
        environment: Mapping[str, str] | None = None,
        is_ordinary: bool = False,
        lifeline: Lifeline | None = None,
        outlived_by: Sequence[Lifeline] = (),
    ) -> None:
        """Start it.

        Args:
            name: of the service.
            command: program and arguments.
            on_event: called from a thread of this object when the child serves and when it has ended.
            on_line: called from a thread of this object with the child's name and each line of its output.
            environment: variables in addition to this process's own.
            is_ordinary: whether it runs at ordinary priority.
            lifeline: its own, closed when it has ended.
            outlived_by: lifelines of children that must end after it.
        """
        self.lifeline = lifeline or Lifeline()
        self.name = name
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self.exited = threading.Event()
        self._on_event = on_event
        self._on_line = on_line
        inherits = [self.lifeline.reader, *(each.writer for each in outlived_by)]
        self._process = start_with_lines(command, environment, inherits)
        self.lifeline.end_with(self._process.pid)
        assert self._process.stdout is not None  # a pipe was asked for
        self.pid = self._process.pid
        self.output = self._process.stdout.fileno()
        if not is_ordinary:
            with contextlib.suppress(PermissionError, ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, self.pid, NICENESS)
        self._reader = threading.Thread(target=self._read, name=f"read {name}", daemon=True)
        self._waiter = threading.Thread(target=self._wait, name=f"wait {name}", daemon=True)
        self._reader.start()
        self._waiter.start()

    @property
    def status(self) -> int | None:
        """Exit status, None while it runs."""
        return self._process.returncode if self.exited.is_set() else None

    @property
    def used_s(self) -> float:
        """Processor time that it and its ended children have used [s]; 0 once it has ended."""
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
        return 0.0

    def stop(self, grace_s: float) -> bool:
        """Ask it to end, and kill the rest of its process group after `grace_s`.

        Returns:
            Whether it ended by itself within the grace.
        """
        self._signal(signal.SIGTERM)
        in_time = self.exited.wait(grace_s)
        self._signal(signal.SIGKILL)
        self.exited.wait()
        self._waiter.join()
        return in_time

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):  # the whole group has ended
            os.killpg(self.pid, number)

    def _read(self) -> None:
        assert self._process.stdout is not None  # a pipe was asked for
        ready = False
        with self._process.stdout as output:
            for line in output:
                text = line.rstrip("\n")
                self.lines.append(text)
                self._on_line(self.name, text)
                if not ready and message_of(text).startswith(READY):
                    ready = True
                    self._on_event(Ready(self.name, text))

    def _wait(self) -> None:
        status = self._process.wait()
        self.lifeline.close()
        # its own children may hold the pipe open for longer than it lives
        self._reader.join(timeout=1.0)
        self.exited.set()
        self._on_event(Exited(self.name, status))


async def while_parent_lives(work: Coroutine[Any, Any, None]) -> None:
    """Await this work, and cancel it at SIGTERM, or if the parent process ends.

    A process descriptor shows the parent's end: unlike the parent-death signal, this does not depend on the thread
    that started this process. The loop handles the signal: a handler that raises could do so inside a callback of
    asyncio, and a task that waits for that callback would wait for ever.
    """
    parent = os.pidfd_open(os.getppid())
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(work)
    ended = False

    def end() -> None:
        nonlocal ended
        ended = True
        loop.remove_reader(parent)
        task.cancel()

    loop.add_reader(parent, end)
    loop.add_signal_handler(signal.SIGTERM, end)
    try:
        await task
    except asyncio.CancelledError:
        if not ended:
            raise
    finally:
        loop.remove_signal_handler(signal.SIGTERM)
        loop.remove_reader(parent)
        os.close(parent)
