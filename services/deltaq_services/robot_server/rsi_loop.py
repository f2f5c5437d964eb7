"""The loop of a Robot Server that speaks RSI: the KRC's datagram is its only clock.

One thread, and one cycle of it:

1. In the middle of the cycle take what has come from the gate and prepare the reply, where the cell wants it; and anew
   whenever more comes.
2. When the telegram comes, send that reply if it is the telegram that was expected and nothing has come since.
3. Decide on the telegram. This is the decision that counts; where nothing was sent in 2, send its reply now.
4. Publish.

The reply of 2 is compared with that of 3, byte by byte. If they ever differ, the robot is held where it was sent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

from deltaq_protocol.guarded import Admission, Supervision
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.crash_brake.record_maker import CrashRecordMaker
from deltaq_services.robot_server.ending import Ending
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_socket import KrcSocket
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.prepared_reply import PreparedReply, TelegramOutcome
from deltaq_services.robot_server.rsi_driver import RsiDriver

if TYPE_CHECKING:  # loads numba, which takes long, and which only those need who prepare replies
    from deltaq_services.robot_server.preparation import Preparation

_FROM = 0.5
"""Share of a cycle after which a reply is prepared. Most of what the gate says in a cycle has come by then."""

_MOST_PREPARED = 3
"""Preparations of one reply, since what the gate says makes one void; with no bound a flood would keep a core busy."""


class RsiLoop:
    """Answers one KRC until the process may end.

    Args:
        server: the core.
        rsi: the driver.
        krc: the socket.
        link: to the gate.
        ending: of the process.
        preparation: of replies; None where none is prepared.
        cycle_s: sample time.
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
        preparation: Preparation | None,
        cycle_s: float,
        silence_s: float,
        records: CrashRecordMaker | None = None,
    ) -> None:
        self._server, self._rsi, self._krc = server, rsi, krc
        self._link, self._ending, self._preparation = link, ending, preparation
        self._arrivals = None if preparation is None else link.tell_arrivals()
        if self._arrivals is not None:
            krc.prepare_to_answer(self._arrivals)
        self._cycle_s, self._silence_s, self._records = cycle_s, silence_s, records
        self._silent_s = 0.0
        self._prepare_s = self._due_s = math.inf
        self._preparations = 0
        self._prepared: PreparedReply | None = None

    def run(self) -> None:
        """Answer telegrams until the process may end."""
        self._silent_s = time.monotonic() + self._silence_s
        while not self._ending.over:
            if self._prepared is not None:
                self._answer(self._prepared)
                continue
            has_come = self._krc.wait(min(self._silent_s, self._prepare_s) - time.monotonic())
            now_s = time.monotonic()
            if self._preparation is not None and not has_come and self._prepare_s <= now_s < self._silent_s:
                self._prepare(self._preparation, now_s)
            else:
                self._read(now_s)

    def _prepare(self, preparation: Preparation, now_s: float) -> None:
        """Prepare the reply."""
        self._prepare_s = math.inf
        self._preparations += 1
        self._hear(now_s)
        self._prepared = preparation.after(self._krc.newest, self._ending.stop, now_s)

    def _answer(self, prepared: PreparedReply) -> None:
        """Wait for the telegram, if it is not there, and answer it with the prepared reply, if it is the one."""
        now_s, self._prepared = time.monotonic(), None
        outcome = self._krc.answer(prepared, self._due_s - now_s, self._silent_s - now_s)
        if outcome is TelegramOutcome.NEWS:
            if self._preparations < _MOST_PREPARED:
                self._prepare_s = self._krc.came_s
        else:
            self._read(self._krc.came_s, prepared if outcome.is_answer else None)

    def _read(self, now_s: float, sent: PreparedReply | None = None) -> None:
        """A datagram has come, to which a prepared reply was sent or none; or the KRC is silent."""
        self._prepared, self._prepare_s = None, math.inf
        measured = self._krc.read(now_s, alone=sent is not None)
        if measured is not None:
            self._silent_s = now_s + self._silence_s
            self._decide(measured, now_s, sent)
            self._link.publish(
                self._server.state, now_s, lambda: _told(self._server.detail, self._krc.detail)
            )
            self._ending.cycle_passed()
            if self._preparation is not None:
                self._preparations = 0
                self._prepare_s, self._due_s = now_s + _FROM * self._cycle_s, now_s + self._cycle_s
            return
        if sent is not None:
            self._disagree(sent)
        elif self._rsi.unmoved is not None:
            self._krc.send(self._rsi.unmoved)
        if now_s >= self._silent_s:
            self._silent_s = now_s + self._silence_s
            self._server.krc_silent(now_s)
            self._link.publish(
                self._server.state, now_s, lambda: _told("KRC silent", self._server.detail, self._krc.detail)
            )
            self._ending.krc_silent()
        else:
            self._link.publish(None, now_s, lambda: _told("waiting for a position", self._krc.detail))

    def _hear(self, now_s: float) -> None:
        """Hand the core what has come from the gate."""
        if self._arrivals is not None:
            self._arrivals.hear()
        messages: list[Admission | Supervision] = [*self._link.admissions()]
        supervision = self._link.supervision()
        if supervision is not None:
            messages.append(supervision)
        for message in messages:
            self._server.take(message, now_s)

    def _decide(self, measured: Measurement, now_s: float, prepared: PreparedReply | None) -> None:
        if prepared is None:
            self._hear(now_s)
        (setpoint,) = self._server.take(measured, now_s)
        stop = self._ending.stop or setpoint.motion_stop
        reply = self._rsi.reply(setpoint.q_cmd, setpoint.outputs, stop)
        if prepared is None:
            self._krc.send_setpoint(reply, self._recorded(measured.ipoc, setpoint.outputs))
        elif reply == prepared.reply:
            self._server.counters["prepared_replies"] += 1
        else:
            self._disagree(prepared)
            return
        if self._rsi.fault is not None:
            self._server.reply_refused(self._rsi.q_sent)

    def _recorded(self, ipoc: int, outputs: Mapping[str, bool]) -> bytes | None:
        """The record to leave before a reply."""
        if self._records is None:
            return None
        return self._records.body(self._records.of_last(self._krc.newest, ipoc, outputs, self._server.motion))

    def _disagree(self, prepared: PreparedReply) -> None:
        """Something else was decided than what was sent: hold where the robot was sent."""
        self._server.counters["prepared_replies_wrong"] += 1
        self._rsi.sent_instead(prepared.correction)
        self._server.reply_refused(self._rsi.q_sent)


def _told(*details: str) -> str:
    return "; ".join(filter(None, details))
