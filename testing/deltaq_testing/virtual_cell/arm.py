"""One robot in virtual time: its emulated KRC, the wire between them, and the Robot Server's process.

A robot without a KRC is where it was sent, and its Robot Server keeps the time itself.
"""

from collections.abc import Callable

from deltaq_emulator.faults import FaultyLink
from deltaq_emulator.krc import Krc
from deltaq_emulator.panel import Panel
from deltaq_emulator.recorder import CsvRecorder
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.guarded import Admission, ServerState, Supervision
from deltaq_protocol.rsi import TelegramError
from deltaq_services.outputs import ToRobot
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.crash_brake.core import CrashBrake, CrashPlan
from deltaq_services.robot_server.crash_brake.record import LastReply
from deltaq_services.robot_server.crash_brake.watch import CrashRecordMaker
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.rsi_driver import RsiDriver
from deltaq_services.robot_server.session import DatagramSource, Peer
from deltaq_testing.virtual_cell.parts import Life, VirtualProcess

HERE = "127.0.0.1"
OTHER_PORT = 2
"""Where others than the KRC send from."""
_KRC: Address = (HERE, 1)


class VirtualArm(VirtualProcess[RobotServer]):
    """A robot with a kinematic driver, and the process of its Robot Server, in virtual time.

    Each cycle, call `begin_cycle`, then `pump` whenever time advances, then `end_cycle`.

    Args:
        begin: makes the Robot Server's core; its argument counts the starts of the process from 1.
        q: (n,) start configuration [rad or m].
        publish: is called with each state that the Robot Server publishes.
        now: gives the virtual time [s].

    Attributes:
        clock_s: offset of the Robot Server's clock [s].
    """

    def __init__(
        self,
        begin: Callable[[int], RobotServer],
        q: Array,
        publish: Callable[[ServerState], None],
        now: Callable[[], float],
    ) -> None:
        self.clock_s = 0.0
        self._publish, self._now = publish, now
        self._q, self._processes = q, 0
        super().__init__(lambda: begin(self._processes))

    @property
    def server(self) -> RobotServer:
        """The Robot Server's core."""
        return self.core

    @property
    def q(self) -> Array:
        """(n,) present configuration of the robot [rad or m]."""
        return self._q

    @property
    def state(self) -> ServerState | None:
        """The newest published state; None while the Robot Server is dead."""
        return None if self.life is Life.DEAD else self.server.state

    @property
    def links(self) -> tuple[FaultyLink, ...]:
        """The simulated wires, on which telegrams may be in transit."""
        return ()

    def start(self) -> None:
        """Start or restart the Robot Server's process."""
        self._processes += 1
        super().start()

    def take(self, message: Admission | Supervision) -> None:
        """Hand a message of the gate to the Robot Server, unless it is frozen or dead."""
        self.do(lambda: self._told(message))

    def begin_cycle(self, now_s: float) -> None:
        """Begin a cycle: measure, get the next setpoint of the Robot Server, move there, and publish the state."""
        if self.life is Life.RUNNING:
            start = self._q if self.server.state is None else None
            self._q = self._answer(Measurement(round(now_s * 1000), self._q, start), now_s).q_cmd
            self._say()

    def pump(self, now_s: float) -> None:
        """Deliver the telegrams and replies that arrive until now_s."""

    def end_cycle(self, now_s: float) -> None:
        """End the cycle; nothing to do here."""

    def _told(self, message: Admission | Supervision) -> None:
        self.server.take(message, self._now() + self.clock_s)

    def _answer(self, measured: Measurement, now_s: float) -> ToRobot:
        (setpoint,) = self.server.take(measured, now_s + self.clock_s)
        return setpoint

    def _say(self) -> None:
        if self.server.state is not None:
            self._publish(self.server.state)


class KrcArm(VirtualArm):
    """A robot with an emulated KRC; further arguments as of `VirtualArm`.

    Args:
        krc: the emulated controller.
        driver: makes the driver of a Robot Server's process.
        plan: of the brake after a Robot Server's death.
        seed: of the wire's random numbers.

    Attributes:
        krc: the emulated controller.
        panel: its panel.
        to_pc, from_pc: the wire between KRC and Robot Server.
        bombard: adds foreign datagrams right after the KRC's telegram; None for none.
    """

    def __init__(
        self,
        krc: Krc,
        driver: Callable[[RobotServer], RsiDriver],
        plan: CrashPlan,
        seed: int,
        begin: Callable[[int], RobotServer],
        publish: Callable[[ServerState], None],
        now: Callable[[], float],
    ) -> None:
        self.krc = krc
        self.to_pc, self.from_pc = FaultyLink(seed), FaultyLink(seed + 1)
        self.bombard: Callable[[bytes], tuple[bytes, Address]] | None = None
        self._driver, self._plan, self._krc_timeout_s = driver, plan, plan.silence_s
        self._telegrams = plan.telegrams()
        self._others: list[tuple[bytes, Address]] = []
        self._sent_s = 0.0
        super().__init__(begin, krc.sample.q, publish, now)
        recorder = CsvRecorder(krc.cycle_s, len(krc.sample.q))
        self.panel = Panel(self.server.robot, krc, *self.links, recorder)

    @property
    def q(self) -> Array:
        """(n,) present configuration of the robot [rad or m]."""
        return self.krc.sample.q

    @property
    def links(self) -> tuple[FaultyLink, FaultyLink]:
        """The simulated wires, on which telegrams may be in transit."""
        return self.to_pc, self.from_pc

    def start(self) -> None:
        """Start or restart the Robot Server's process."""
        super().start()
        self._rsi = self._driver(self.server)
        self._peer = Peer(None, self._krc_timeout_s)
        self._unanswered: bytes | None = None
        self._heard_s = self._now()
        self._answered: tuple[bytes, int] | None = None
        self._crash_brake: CrashBrake | None = None

    def kill(self) -> None:
        """End the Robot Server at once; the process beside it brakes the robot."""
        if self.life is not Life.DEAD and self._answered is not None:
            maker = CrashRecordMaker(self._plan, self._rsi, tuple(self.server.outputs))
            record = maker.of_last(*self._answered, self.server.outputs, self.server.motion)
            if record is not None:
                found = LastReply(record, _KRC, self._heard_s, was_sent=True)
                self._crash_brake = CrashBrake(self._plan, found, self._telegrams)
        super().kill()

    def thaw(self) -> None:
        """Resume a frozen Robot Server; it answers the newest telegram that arrived meanwhile."""
        super().thaw()
        if self._unanswered is not None:
            self._read(self._unanswered, self._now(), _KRC)

    def begin_cycle(self, now_s: float) -> None:
        """Begin a cycle of the KRC: it sends its telegram, and others send forged ones."""
        telegram = self.krc.tick()
        self._sent_s = now_s
        if telegram is not None:
            self.to_pc.put(now_s, telegram)
            forgeries = self.panel.forgeries
            self._others = [(self.krc.forged(one), (one.address, OTHER_PORT)) for one in forgeries]
            if self.bombard is not None:
                self._others.append(self.bombard(telegram))

    def pump(self, now_s: float) -> None:
        """Deliver the telegrams and replies that arrive until now_s."""
        arrived = self.to_pc.take(now_s)
        if self.life is Life.FROZEN and arrived:
            self._unanswered = arrived[-1]
        others, self._others = self._others, []
        if self.life is Life.RUNNING:
            for datagram, sender in [*((own, _KRC) for own in arrived), *others]:
                self._read(datagram, now_s, sender)
        elif self.life is Life.DEAD and self._crash_brake is not None:
            waiting = [*((own, _KRC) for own in arrived), *others]
            reply = self._crash_brake.answer(waiting, now_s)
            if reply is not None:
                self.from_pc.put(now_s, reply)
        for datagram in self.from_pc.take(now_s):
            self.krc.receive(datagram, now_s - self._sent_s)

    def end_cycle(self, now_s: float) -> None:
        """End the cycle: tell the Robot Server if the KRC has been silent for its timeout."""
        if self.life is Life.RUNNING and now_s - self._heard_s >= self._krc_timeout_s:
            self._heard_s = now_s
            self.server.krc_silent(now_s + self.clock_s)
            self._say()

    def _read(self, datagram: bytes, now_s: float, sender: Address) -> None:
        who = self._peer.judge(sender, now_s)
        if who is not DatagramSource.KRC:
            self.server.counters[who] += 1
            return
        self._unanswered = None
        try:
            measured = self._rsi.read(datagram, now_s)
        except TelegramError:
            self.server.counters["telegrams_garbled"] += 1
            return
        self._peer.believed(sender, now_s)
        if measured is None:
            if self._rsi.unmoved is not None:
                self.from_pc.put(now_s, self._rsi.unmoved)
            return
        self._heard_s = now_s
        setpoint = self._answer(measured, now_s)
        self._answered = datagram, measured.ipoc
        self.from_pc.put(now_s, self._rsi.reply(setpoint.q_cmd, setpoint.outputs, setpoint.motion_stop))
        if self._rsi.fault is not None:
            self.server.reply_refused(self._rsi.q_sent)
        self._say()
