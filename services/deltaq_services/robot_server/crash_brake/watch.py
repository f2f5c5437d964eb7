"""The Robot Server's side of the crash brake: starts the process that brakes after its death, and writes records."""

import contextlib
import logging
import mmap
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from deltaq_protocol.endpoint import Address
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.robot_server.crash_brake.core import CrashPlan, bounded
from deltaq_services.robot_server.crash_brake.memory import CrashMemory
from deltaq_services.robot_server.crash_brake.record import CrashRecord, CrashRecords
from deltaq_services.robot_server.rsi_driver import RsiDriver


class CrashRecordMaker:
    """Makes the records of one robot.

    Args:
        plan: of the robot.
        rsi: its driver, which is only read.
        outputs: names of its digital outputs, in the order of the cell.
    """

    def __init__(self, plan: CrashPlan, rsi: RsiDriver, outputs: tuple[str, ...]) -> None:
        self._telegrams = plan.telegrams()
        self._records = CrashRecords(len(plan.most), plan.outputs)
        self._rsi, self._outputs = rsi, outputs

    def body(self, record: CrashRecord | None) -> bytes | None:
        """The bytes of a record, see `CrashRecords.body`; None if a number does not fit into it."""
        try:
            return None if record is None else self._records.body(record)
        except struct.error:
            return None

    def of_last(
        self, datagram: bytes, ipoc: int, outputs: Mapping[str, bool], motion: SetpointMotion
    ) -> CrashRecord | None:
        """The record of the reply that the driver made last.

        Args:
            datagram: the telegram that is answered, which the driver has read last.
            ipoc: of that telegram.
            outputs: of the reply, by name.
            motion: the motion that the reply belongs to.

        Returns:
            None if no process could continue from it, because the telegram does not have the usual layout.
        """
        telegram, ipoc_step = self._rsi.session.last, self._rsi.session.step
        if telegram is None or not telegram.is_usual or ipoc_step is None:
            return None
        if self._rsi.fault is not None:
            motion = SetpointMotion.at_rest(motion.q_cmd)  # the KRC gets its last correction again, and stays
        lower, upper = self._rsi.limits
        return CrashRecord(
            ipoc=ipoc,
            late=bounded(telegram.delay or 0),
            programmed=self._telegrams.programmed(datagram),
            ipoc_step=ipoc_step,
            outputs=tuple([bool(outputs.get(name)) for name in self._outputs]),
            correction=self._rsi.correction,
            plan_dq=tuple(motion.plan_dq.tolist()),
            brake_cycles=motion.brake_cycles,
            step=motion.step,
            lower=lower,
            upper=upper,
        )


_log = logging.getLogger(__name__)
_AGAIN_S = 1.0
"""Between two starts of a process that does not stay."""
_KILLED_S = 0.05
"""A killed process is gone by then."""
_PROCESS = "deltaq_services.robot_server.crash_brake.process"


class CrashWatch:
    """The crash brake's process and shared memory; a context manager that ends both.

    Left without an error, the process does nothing; left with an error, it brakes the robot. A process that has
    ended or was stopped is replaced; see `ready` and `mend`.

    Args:
        plan: of the robot.
        sock: to its KRC.
        robot: its name, for the log.
    """

    def __init__(self, plan: CrashPlan, sock: socket.socket, robot: str = "") -> None:
        records = CrashRecords(len(plan.most), plan.outputs)
        self._plan, self._socket, self._robot = plan, sock, robot
        self._shared = os.memfd_create("deltaq-crash-brake")
        os.ftruncate(self._shared, CrashMemory.bytes_for(records))
        self._file = mmap.mmap(self._shared, 0)
        self._memory = CrashMemory(self._file, records)
        self._memory.mutex.own()
        _dump_no_core()
        self._lost, self._start_s = "", 0.0
        self._process = self._started()

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
        os.close(self._shared)

    @property
    def ready(self) -> bool:
        """Whether the process waits for this one's end; one system call."""
        return self._memory.armed and not self._fault()

    def mend(self, now_s: float) -> None:
        """Start another process in place of one that has ended or was stopped, and log both.

        Args:
            now_s: on the monotonic clock.
        """
        if not (fault := self._fault()):
            if self._lost and self._memory.armed:
                _log.warning("the process that brakes %s is ready again; a reset permits motion", self._robot)
                self._lost = ""
            return
        if fault != self._lost:
            _log.error(
                "the crash brake of %s %s: %s is held while another starts",
                self._robot, fault, self._robot,
            )  # fmt: skip
            self._lost = fault
        if now_s < self._start_s:
            return
        self._start_s = now_s + _AGAIN_S
        self._process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_KILLED_S)
        self._memory.armed = False
        try:
            self._process = self._started()
        except OSError as error:
            _log.error("it cannot be started (%s); tried again every second", error)

    def _started(self) -> subprocess.Popen[str]:
        descriptors = (self._shared, self._socket.fileno())
        process = subprocess.Popen(
            [sys.executable, "-m", _PROCESS, *map(str, descriptors), self._robot],
            stdin=subprocess.PIPE,
            pass_fds=descriptors,
            start_new_session=True,  # a signal to the Robot Server's process group does not reach it
            text=True,
        )
        assert process.stdin is not None  # a pipe was asked for
        with contextlib.suppress(BrokenPipeError), process.stdin as plans:  # `ready` tells that it has ended
            plans.write(self._plan.json())
        return process

    def _fault(self) -> str:
        """How the process ended, or what stopped it; empty if it runs."""
        status = self._process.returncode
        if status is None:
            kinds = os.WEXITED | os.WSTOPPED | os.WNOHANG | os.WNOWAIT
            found = os.waitid(os.P_PID, self._process.pid, kinds)
            if found is None:
                return ""
            if found.si_code == os.CLD_STOPPED:
                return f"was stopped by {signal.Signals(found.si_status).name}"
            status = found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
        return (
            f"ended with exit status {status}"
            if status >= 0
            else f"was ended by {signal.Signals(-status).name}"
        )

    @property
    def pid(self) -> int:
        """Id of the crash brake's process."""
        return self._process.pid

    @property
    def longest_s(self) -> float:
        """Upper bound of a brake's duration [s]: every cycle of it may take almost a KRC's timeout."""
        return 10.0 * self._plan.silence_s + 1.0

    @property
    def detail(self) -> str:
        """The fault, as text; empty if there is none."""
        if self.ready:
            return ""
        return f"the crash brake's process {self._fault() or 'is starting'}"

    def write(self, body: bytes | None, peer: Address, time_s: float) -> None:
        """Write the record of the reply that is about to be sent; None if no process could continue from it."""
        if body is None:
            self._memory.clear()
        else:
            self._memory.write(body, peer, time_s)

    def sent(self) -> None:
        """Note that the reply was handed to the network."""
        self._memory.sent()


def _dump_no_core() -> None:
    """Have no core dumped: it would be written before the mutex is passed on, cycles too late.

    A limit of one byte refuses dumps to files and to programs alike (core(5)).
    """
    import resource  # not on Windows, where virtual time makes records, too

    hard = resource.getrlimit(resource.RLIMIT_CORE)[1]
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (1, hard))
