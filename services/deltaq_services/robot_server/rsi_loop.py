"""The loop of a Robot Server that speaks RSI: the KRC's datagram is its only clock.

One thread, and one cycle of it:

1. A little before the telegram is due, take what has come from the gate and prepare the reply.
2. When the telegram comes, send that reply if it is the telegram that was expected and nothing has come since.
3. Decide on the telegram. This is the decision that counts; where nothing was sent in 2, send its reply now.
4. Publish.

The reply of 2 is compared with that of 3, byte by byte. If they ever differ, the robot is held where it was sent.
"""

from __future__ import annotations

import time

from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.ending import Ending
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.robot_server.krc_socket import KrcSocket
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.preparation import Preparation
from deltaq_services.robot_server.prepared_reply import PreparedReply
from deltaq_services.robot_server.rsi_driver import RsiDriver

LEAD_S = 0.001
"""How long before a telegram is due its reply is prepared: longer than that takes."""


class RsiLoop:
    """Answers one KRC until the process may end.

    Args:
        server: the core.
        rsi: the driver.
        krc: the socket.
        link: to the gate.
        ending: of the process.
        preparation: of replies.
        cycle_s: sample time.
        silence_s: after which a KRC counts as silent.
    """

    def __init__(
        self,
        server: RobotServer,
        rsi: RsiDriver,
        krc: KrcSocket,
        link: GuardedLink,
        ending: Ending,
        preparation: Preparation,
        cycle_s: float,
        silence_s: float,
    ) -> None:
        self._server, self._rsi, self._krc = server, rsi, krc
        self._link, self._ending, self._preparation = link, ending, preparation
        self._cycle_s, self._silence_s = cycle_s, silence_s
        self._silent_s = 0.0
        self._prepare_s = 0.0
        self._prepared: PreparedReply | None = None

    def run(self) -> None:
        """Answer telegrams until the process may end."""
        now_s = time.monotonic()
        self._silent_s, self._prepare_s = now_s + self._silence_s, self._silent_s
        while not self._ending.over:
            has_come = self._krc.wait(min(self._silent_s, self._prepare_s) - now_s)
            now_s = time.monotonic()
            if not has_come and self._prepare_s <= now_s < self._silent_s:
                self._prepare(now_s)
            else:
                self._look(now_s)
            now_s = time.monotonic()

    def _prepare(self, now_s: float) -> None:
        self._prepare_s = self._silent_s
        self._hear(now_s)
        self._prepared = self._preparation.after(self._krc.newest, self._ending.stop, now_s)

    def _hear(self, now_s: float) -> None:
        for admission in self._link.admissions():
            self._server.take(admission, now_s)
        supervision = self._link.supervision()
        if supervision is not None:
            self._server.take(supervision, now_s)

    def _look(self, now_s: float) -> None:
        """A datagram has come, or the KRC is silent."""
        prepared, self._prepared = self._prepared, None
        if prepared is not None and (self._link.has_come() or not self._krc.answer(prepared)):
            prepared = None
        measured = self._krc.read(now_s, alone=prepared is not None)
        if measured is not None:
            self._silent_s = now_s + self._silence_s
            self._prepare_s = now_s + self._cycle_s - LEAD_S
            self._decide(measured, now_s, prepared)
            self._link.publish(
                self._server.state, now_s, lambda: _told(self._server.detail, self._krc.detail)
            )
            self._ending.cycle_passed()
            return
        self._prepare_s = self._silent_s
        if prepared is not None:
            self._disagree(prepared)
        elif self._rsi.unmoved is not None:
            self._krc.send(self._rsi.unmoved)
        if now_s >= self._silent_s:
            self._prepare_s = self._silent_s = now_s + self._silence_s
            self._server.krc_silent(now_s)
            self._link.publish(
                self._server.state, now_s, lambda: _told("KRC silent", self._server.detail, self._krc.detail)
            )
            self._ending.krc_silent()
        else:
            self._link.publish(None, now_s, lambda: _told("waiting for a position", self._krc.detail))

    def _decide(self, measured: Measurement, now_s: float, prepared: PreparedReply | None) -> None:
        if prepared is None:
            self._hear(now_s)
        (setpoint,) = self._server.take(measured, now_s)
        stop = self._ending.stop or setpoint.motion_stop
        reply = self._rsi.reply(setpoint.q_cmd, setpoint.outputs, stop)
        if prepared is None:
            self._krc.send(reply)
        elif reply == prepared.reply:
            self._server.counters["prepared_replies"] += 1
        else:
            self._disagree(prepared)
            return
        if self._rsi.fault is not None:
            self._server.reply_refused(self._rsi.q_sent)

    def _disagree(self, prepared: PreparedReply) -> None:
        """Something else was decided than what was sent: hold where the robot was sent."""
        self._server.counters["prepared_replies_wrong"] += 1
        self._rsi.sent_instead(prepared.correction)
        self._server.reply_refused(self._rsi.q_sent)


def _told(*details: str) -> str:
    return "; ".join(filter(None, details))
