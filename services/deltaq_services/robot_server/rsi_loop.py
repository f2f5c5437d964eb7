"""The loop of a Robot Server that speaks RSI: the KRC's datagram is its only clock.

One thread, and one cycle of it:

1. Wait for the telegram.
2. Take what has come from the gate, decide, and send the reply.
3. Publish.

An error that nobody foresaw in any of them holds the robot: a telegram that cannot be read is none, a reply that cannot
be made is none that was sent. Only a core that cannot even brake ends the process.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from deltaq_services.containment import Containment
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.crash_brake.record_maker import CrashRecordMaker
from deltaq_services.robot_server.ending import Ending
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_socket import KrcSocket
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver

_log = logging.getLogger(__name__)


class RsiLoop:
    """Answers one KRC until the process may end.

    Args:
        server: the core.
        rsi: the driver.
        krc: the socket.
        link: to the gate.
        ending: of the process.
        silence_s: after which a KRC counts as silent.
        records: makes those that are left before replies; None if none are.
    """

    def __init__(
        self,
        server: RobotServer,
        rsi: RsiDriver,
        krc: KrcSocket,
        link: GuardedLink,
        ending: Ending,
        silence_s: float,
        records: CrashRecordMaker | None = None,
    ) -> None:
        self._server, self._rsi, self._krc = server, rsi, krc
        self._link, self._ending = link, ending
        self._silence_s, self._records = silence_s, records
        self._silent_s = 0.0
        self._cycle_fault = ""
        self._driver = Containment(lambda: (rsi, rsi.session))

    def run(self) -> None:
        """Answer telegrams until the process may end."""
        self._silent_s = time.monotonic() + self._silence_s
        while not self._ending.over:
            self._krc.wait(self._silent_s - time.monotonic())
            self._read(time.monotonic())
            self._server.containment.log_once(_log)
            if self._krc.watch is not None:
                self._krc.watch.mend(time.monotonic())

    def _read(self, now_s: float) -> None:
        """Answer the telegram that has come, if one has, or notice that the KRC is silent."""
        measured = None
        self._driver.remember()
        with self._held_by_errors(self._driver.put_back):
            measured = self._krc.read(now_s)
        if measured is not None:
            self._silent_s = now_s + self._silence_s
            self._decide(measured, now_s)
            self._publish(now_s)
            self._ending.cycle_passed()
            self._warn(measured.cycle_fault)
            return
        if self._rsi.unmoved is not None:
            self._krc.send(self._rsi.unmoved)
        if now_s >= self._silent_s:
            self._silent_s = now_s + self._silence_s
            self._server.krc_silent(now_s)
            self._publish(now_s, "KRC silent")
            self._ending.krc_silent()
        else:
            with self._held_by_errors():
                self._link.publish(None, now_s, lambda: _told("waiting for a position", self._krc.detail))

    def _publish(self, now_s: float, what: str = "") -> None:
        with self._held_by_errors():
            state = self._server.state
            self._link.publish(state, now_s, lambda: _told(what, self._server.detail, self._krc.detail))

    @contextmanager
    def _held_by_errors(self, undo: Callable[[], None] | None = None) -> Iterator[None]:
        """Holds the robot if an error befalls the block, and undoes what the block has done."""
        try:
            yield
        except Exception as error:
            if undo is not None:
                undo()
            self._server.failed(error)

    def _warn(self, cycle_fault: str) -> None:
        """Log why the KRC's cycle is not the cell's, once while it is not."""
        if cycle_fault and not self._cycle_fault:
            _log.warning("%s", cycle_fault)
        self._cycle_fault = cycle_fault

    def _decide(self, measured: Measurement, now_s: float) -> None:
        with self._held_by_errors():
            for message in self._link.heard():
                self._server.take(message, now_s)
        self._server.guarded = self._krc.is_guarded
        (setpoint,) = self._server.take(measured, now_s)
        stop = self._ending.stop or setpoint.motion_stop
        reply = None
        self._driver.remember()
        with self._held_by_errors(self._driver.put_back):
            reply = self._rsi.reply(setpoint.q_cmd, setpoint.outputs, stop)
            record = self._recorded(measured.ipoc, setpoint.outputs)
        if reply is not None:
            with self._held_by_errors():
                self._krc.send_setpoint(reply, record)
        if reply is None or self._rsi.fault is not None:
            self._server.reply_refused(self._rsi.q_sent)

    def _recorded(self, ipoc: int, outputs: Mapping[str, bool]) -> bytes | None:
        """The record to leave before a reply."""
        if self._records is None:
            return None
        return self._records.body(self._records.of_last(self._krc.newest, ipoc, outputs, self._server.motion))


def _told(*details: str) -> str:
    return "; ".join(filter(None, details))
