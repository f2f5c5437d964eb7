"""The Robot Server's side of the brake after its own death: it starts the process for that, and leaves records."""

from __future__ import annotations

import contextlib
import mmap
import os
import resource
import socket
import subprocess
import sys
from types import TracebackType
from typing import Self

from deltaq_protocol.endpoint import Address
from deltaq_services.robot_server.crash_brake.core import CrashPlan
from deltaq_services.robot_server.crash_brake.memory import CrashMemory
from deltaq_services.robot_server.crash_brake.record import CrashRecords

_PROCESS = "deltaq_services.robot_server.crash_brake.process"


class CrashWatch:
    """One process, and the memory shared with it; a context manager that lets it end.

    Left without an error, the process has nothing to do. With one, however small, it brakes the robot.

    Args:
        plan: of the robot.
        sock: to its KRC.
        robot: its name, for what the process says.
    """

    def __init__(self, plan: CrashPlan, sock: socket.socket, robot: str = "") -> None:
        records = CrashRecords(len(plan.most), plan.outputs)
        self._plan = plan
        shared = os.memfd_create("deltaq-crash-brake")
        try:
            os.ftruncate(shared, CrashMemory.bytes_for(records))
            self._file = mmap.mmap(shared, 0)
            self._memory = CrashMemory(self._file, records)
            self._memory.mutex.own()
            _dump_no_core()
            self._process = subprocess.Popen(
                [sys.executable, "-m", _PROCESS, str(shared), str(sock.fileno()), robot],
                stdin=subprocess.PIPE,
                pass_fds=(shared, sock.fileno()),
                start_new_session=True,  # what kills the Robot Server's process group does not reach it
                text=True,
            )
        finally:
            os.close(shared)
        assert self._process.stdin is not None  # a pipe was asked for
        with (
            contextlib.suppress(BrokenPipeError),
            self._process.stdin as plans,
        ):  # `detail` tells that it has ended
            plans.write(plan.json())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._memory.released = kind is None
        self._memory.mutex.let_go()
        try:
            self._process.wait(self.longest_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._memory.close()
        self._file.close()

    @property
    def pid(self) -> int:
        """The process."""
        return self._process.pid

    @property
    def longest_s(self) -> float:
        """Longer than that no robot brakes: every cycle of a brake may come after all but a KRC's timeout."""
        return 10.0 * self._plan.silence_s + 1.0

    @property
    def detail(self) -> str:
        """The fault, for people; empty if there is none."""
        if self._process.poll() is not None:
            return "the process that would brake the robot if this one died has ended: restart this service"
        return (
            ""
            if self._memory.armed
            else "the process that would brake the robot if this one died is starting"
        )

    def write(self, body: bytes | None, peer: Address, time_s: float) -> None:
        """Leave a record of the reply that is about to be sent; None: no process could continue from it."""
        if body is None:
            self._memory.clear()
        else:
            self._memory.write(body, peer, time_s)

    def sent(self) -> None:
        """The reply was handed to the network."""
        self._memory.sent()


def _dump_no_core() -> None:
    """Have no core dumped: it would be written before the mutex is passed on, cycles too late.

    A limit of one byte refuses dumps to files and to programs alike (core(5)).
    """
    hard = resource.getrlimit(resource.RLIMIT_CORE)[1]
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (1, hard))
