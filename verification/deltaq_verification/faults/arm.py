"""One robot under fault: its emulated KRC, the link to it, and the Robot Server's process."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from deltaq_emulator.faults import FaultyLink
from deltaq_emulator.krc import Krc
from deltaq_emulator.panel import Panel
from deltaq_emulator.recorder import CsvRecorder
from deltaq_protocol.guarded import Admission, ServerState, Supervision
from deltaq_protocol.messages import Message
from deltaq_protocol.rsi import TelegramError
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.peer import Address, Peer, Sender
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_verification.faults.actions import Bombard

HERE = "127.0.0.1"
OVERSIZE = 5000
"""Bytes behind a telegram that make it longer than any."""
_KRC: Address = (HERE, 1)
_OTHER_PORT = 2


class Life(Enum):
    """Whether a process runs, stands still or is gone."""

    RUNNING = 0
    FROZEN = 1
    DEAD = 2


class VirtualArm:
    """One robot, from its KRC to its Robot Server.

    Args:
        name: of the robot.
        krc: the emulated controller.
        begin: makes the Robot Server's core and its driver, as a process of the given number does when it starts.
        publish: takes each state that the Robot Server publishes.
        krc_timeout_s: silence after which the Robot Server says so.
        seed: of the wire's random numbers.

    Attributes:
        panel: of the emulated controller.
        to_pc, from_pc: the wire between KRC and Robot Server.
        life: of the Robot Server's process.
        clock_s: what the Robot Server's clock is ahead.
        bombard: what somebody sends to the Robot Server beside the KRC.
    """

    def __init__(
        self,
        name: str,
        krc: Krc,
        begin: Callable[[int], tuple[RobotServer, RsiDriver]],
        publish: Callable[[ServerState], None],
        krc_timeout_s: float,
        seed: int,
    ) -> None:
        self.krc = krc
        self.to_pc, self.from_pc = FaultyLink(seed), FaultyLink(seed + 1)
        self.panel = Panel(name, krc, self.to_pc, self.from_pc, CsvRecorder(krc.cycle_s, len(krc.sample.q)))
        self.clock_s = 0.0
        self.bombard: Bombard | None = None
        self._begin, self._publish, self._krc_timeout_s = begin, publish, krc_timeout_s
        self._others: list[tuple[bytes, Address]] = []
        self._sent_s, self._processes = 0.0, 0
        self.restart(0.0)

    @property
    def state(self) -> ServerState | None:
        """What the Robot Server published last; None while it is dead."""
        return None if self.life is Life.DEAD else self._server.state

    def restart(self, now_s: float) -> None:
        """Start the Robot Server's process, anew."""
        self.life = Life.RUNNING
        self._processes += 1
        self._server, self._rsi = self._begin(self._processes)
        self._peer = Peer(None, self._krc_timeout_s)
        self._admission: Admission | None = None
        self._supervision: Supervision | None = None
        self._waiting: bytes | None = None
        self._heard_s = now_s

    def thaw(self, now_s: float) -> None:
        """Let the Robot Server go on; of the telegrams that came meanwhile it answers the newest."""
        self.life = Life.RUNNING
        if self._waiting is not None:
            self._answer(self._waiting, now_s)

    def begin_cycle(self, now_s: float) -> None:
        """The KRC's clock ticks."""
        telegram = self.krc.tick()
        self._sent_s = now_s
        if telegram is not None:
            self.to_pc.put(now_s, telegram)
            self._others = self._from_others(telegram)

    def take(self, message: Message) -> None:
        """The gate has spoken; of each kind the newest is kept, as a ring channel keeps it."""
        if self.life is Life.DEAD:
            return
        if isinstance(message, Admission):
            self._admission = message
        elif isinstance(message, Supervision):
            self._supervision = message

    def pump(self, now_s: float) -> None:
        """Carry telegrams and replies that arrive by now."""
        for datagram in self.to_pc.take(now_s):
            if self.life is Life.RUNNING:
                self._answer(datagram, now_s)
            elif self.life is Life.FROZEN:
                self._waiting = datagram
        others, self._others = self._others, []
        for datagram, sender in others:
            if self.life is Life.RUNNING:
                self._answer(datagram, now_s, sender)
        for datagram in self.from_pc.take(now_s):
            self.krc.receive(datagram, now_s - self._sent_s)

    def end_cycle(self, now_s: float) -> None:
        """Notice a KRC that has been silent for too long."""
        if self.life is Life.RUNNING and now_s - self._heard_s >= self._krc_timeout_s:
            self._heard_s = now_s
            self._server.krc_silent(now_s + self.clock_s)
            self._say()

    def _from_others(self, telegram: bytes) -> list[tuple[bytes, Address]]:
        """What others send right after the KRC, as `Strangers` do it live."""
        forged = [
            (self.krc.forged(forgery), (forgery.address, _OTHER_PORT)) for forgery in self.panel.forgeries
        ]
        match self.bombard:
            case Bombard.OVERSIZED:
                forged += [(telegram + b" " * OVERSIZE, (HERE, _OTHER_PORT))]
            case Bombard.PORT_ZERO:
                forged += [(telegram, (HERE, 0))]
        return forged

    def _answer(self, datagram: bytes, now_s: float, sender: Address = _KRC) -> None:
        who = self._peer.judge(sender, now_s)
        if who is not Sender.KRC:
            self._server.counters[who] += 1
            return
        self._waiting = None
        try:
            measured = self._rsi.read(datagram, now_s)
        except TelegramError:
            self._server.counters["telegrams_garbled"] += 1
            return
        self._peer.believed(sender, now_s)
        if measured is None:
            if self._rsi.unmoved is not None:
                self.from_pc.put(now_s, self._rsi.unmoved)
            return
        self._heard_s = now_s
        admission, self._admission = self._admission, None
        supervision, self._supervision = self._supervision, None
        q_cmd = self._server.cycle(measured, now_s + self.clock_s, admission, supervision)
        reply = self._rsi.reply(q_cmd, self._server.outputs, self._server.motion_stop)
        self.from_pc.put(now_s, reply)
        if self._rsi.fault is not None:
            self._server.reply_refused(self._rsi.q_sent)
        self._say()

    def _say(self) -> None:
        if self._server.state is not None:
            self._publish(self._server.state)
