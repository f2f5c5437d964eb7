"""The system with RSI's own code at the Robot Server's end of the KRC's wire, and an attacker on that wire.

An attack is one datagram forged, doubled, overtaken or lost, a reply lost, a KRC that falls silent for as long as it
likes, or somebody who from now on passes for a KRC. It costs one of a small number. What the HLI may send is less than
in `System`: nothing, the fastest increment, a stop or a reset.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from deltaq_proofs.model_checker.gate_side import Act
from deltaq_proofs.model_checker.one_joint import FASTEST, IPOC_STEP, ROBOT, STEP, one_joint_cell
from deltaq_proofs.model_checker.rsi_line import (
    KRC_AT,
    SECOND_AT,
    STRANGER_AT,
    Own,
    Program,
    RsiLine,
    new_line,
    new_program,
)
from deltaq_proofs.model_checker.safety_monitor import Property, Telegram, Violation
from deltaq_proofs.model_checker.system import System, at_hand, judge_course
from deltaq_proofs.model_checker.system_state import KEPT, SentState, SystemState, Turn
from deltaq_protocol.endpoint import Address
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.session import DatagramSource

_ELSEWHERE = 3 * STEP
"""How far off a forged position is: no further than the joint could have moved [m]."""
_AWAY = 6 * STEP
"""Where the robot has got to as the attacks begin: near enough to be taken for standing where it is programmed [m]."""
_FAR = 1000 * IPOC_STEP
_TOLD = 1e-12
"""What sums of powers of two lose [m]: nothing, but differences of decimals do."""


class AttackedSystem(System):
    """The system, and an attacker on RSI's wire.

    Args:
        attacks: on one way, at most.
    """

    def __init__(self, attacks: int = 1) -> None:
        super().__init__()
        self._attacks = attacks
        self._line_description = one_joint_cell(rsi=True)
        self._program = self._new_program()
        driver, peer = self._program
        self._blank_driver, self._blank_peer = driver.snapshot(), peer.snapshot()

    def start(self, faults: int) -> SystemState:
        """A robot that moves, away from where its session began; nobody was attacked before."""
        line = new_line(self._blank_driver, self._blank_peer, self._attacks)
        system_state = replace(super().start(faults), line=line)
        while system_state.server.state is None or system_state.server.state.q_cmd[0] < _AWAY:
            admission = len(system_state.admissions) - 1 if system_state.new_admission else None
            supervision = len(system_state.supervisions) - 1 if system_state.new_supervision else None
            system_state = self._own(system_state, admission, supervision)
            if system_state.turn is Turn.STATE:
                system_state = self._take_states(system_state, -1)
                *_, (_, _, request) = (
                    move for move in self.hli(system_state) if move[0].startswith("request")
                )
                system_state = request(system_state)
            system_state = replace(system_state, turn=Turn.TELEGRAM)
        return system_state

    def _new_program(self) -> Program:
        return new_program(self._line_description)

    def hli(self, system_state: SystemState) -> Iterator[tuple[str, int, Act]]:
        """What the HLI can send: little, for what more there is `System` explores."""
        state = system_state.gate.robots[ROBOT].tracker.state
        fastest = 0 if state is None else min(FASTEST, round(state.dq[0] / STEP) + 1)
        kept = ("the HLI says nothing", f"request for {fastest}", "stop", "reset")
        yield from (move for move in super().hli(system_state) if move[0] in kept)

    # --- the wire ---------------------------------------------------------------------------------------------

    def _telegrams(self, system_state: SystemState) -> Iterator[tuple[str, int, Act]]:
        line = _line(system_state)
        admission = len(system_state.admissions) - 1 if system_state.new_admission else None
        supervision = len(system_state.supervisions) - 1 if system_state.new_supervision else None
        own = partial(self._own, a=admission, s=supervision)
        if line.silent:
            yield "the KRC stays silent", 0, partial(self._own, a=None, s=None, sends=False)
        yield "telegram", 0, own
        if line.clock is not None and not line.posed:
            yield f"telegram of who poses as a KRC from {line.poses_at}", 0, self._pose
        yield "the Robot Server crashes", 1, self._server_crash
        if not line.attacks_left:
            return
        yield "the KRC falls silent", 0, _attack(partial(self._own, a=None, s=None, sends=False))
        yield "the KRC begins a new session", 0, _attack(self._begins_anew)
        yield "the KRC begins a new session elsewhere", 0, _attack(partial(self._begins_anew, off=_ELSEWHERE))
        yield "telegram, its reply lost", 0, _attack(partial(own, takes=False))
        yield "telegram, lost", 0, _attack(partial(own, arrives=False))
        yield "telegram, kept back", 0, _attack(partial(own, arrives=False, keeps_back=True))
        for what, forged in self._forgeries(line):
            yield f"{what}, forged", 0, _attack(partial(self._datagram, datagram=forged))
        if line.clock is None:
            for at in (KRC_AT, SECOND_AT, STRANGER_AT):
                yield f"somebody poses as a KRC from {at}", 0, _attack(partial(_posing, at=at))

    @staticmethod
    def _forgeries(line: RsiLine) -> Iterator[tuple[str, Own]]:
        """Datagrams that carry the KRC's own address and come before its next telegram."""
        krc = line.krc
        following = Own(krc.ipoc + IPOC_STEP, krc.stands, krc.programmed, krc.delay)
        yield "next telegram", following
        yield "next telegram, elsewhere", following._replace(q=krc.stands + _ELSEWHERE)
        moved = following._replace(q=krc.stands + _ELSEWHERE, programmed=krc.programmed + _ELSEWHERE)
        yield "next telegram, programmed elsewhere", moved
        yield "far telegram", following._replace(ipoc=krc.ipoc + _FAR)
        at = krc.stands + _ELSEWHERE
        yield "far telegram, elsewhere", Own(krc.ipoc + _FAR, at, at)
        if line.sent is not None:
            yield "last telegram again", line.sent

    # --- what the KRC and the attacker do -----------------------------------------------------------------------

    def _own(
        self,
        system_state: SystemState,
        a: int | None,
        s: int | None,
        sends: bool = True,
        arrives: bool = True,
        takes: bool = True,
        keeps_back: bool = False,
    ) -> SystemState:
        """A cycle of the KRC, with its telegram unless it is silent; then it is the gate's turn."""
        line = _line(system_state)
        before, overtaken = system_state.server.state, line.overtaken
        line = replace(line, krc=line.krc.ticked(), silent=not sends, posed=False)
        tick = system_state.ticks + 1
        system_state = replace(system_state, ticks=tick, line=line)
        if sends:
            krc = line.krc
            own = Own(krc.ipoc, krc.stands, krc.programmed, krc.delay)
            line = replace(line, sent=own, overtaken=own if keeps_back else line.overtaken)
            system_state = replace(system_state, line=line)
            if arrives:
                system_state = self._datagram(system_state, own, a=a, s=s, takes=takes)
                if overtaken is not None:
                    system_state = self._datagram(
                        replace(system_state, line=replace(_line(system_state), overtaken=None)), overtaken
                    )
        if _line(system_state).heard < tick and _line(system_state).is_silent(tick):
            system_state = self._hears_nothing(system_state)
        published = system_state.server.state is not before
        return replace(system_state, turn=Turn.STATE if published else Turn.HLI)

    def _hears_nothing(self, system_state: SystemState) -> SystemState:
        line = _line(system_state)
        if system_state.server.state is None:
            return system_state
        silent = self._silence(system_state)
        # the brake is forgotten where it stands; what the KRC did not take of it, it may still take
        return replace(silent, ticks=system_state.ticks, line=line)

    def _begins_anew(self, system_state: SystemState, off: float = 0.0) -> SystemState:
        line = _line(system_state)
        line = replace(line, krc=line.krc.begun_anew(off), pending=())
        return self._own(replace(system_state, line=line), None, None)

    def _pose(self, system_state: SystemState) -> SystemState:
        line = _line(system_state)
        assert line.clock is not None  # offered only then
        at = line.krc.programmed + _ELSEWHERE
        posed = Own(line.clock, at, at)
        line = replace(line, clock=line.clock + IPOC_STEP, posed=True)
        return self._datagram(replace(system_state, line=line), posed, sender=line.poses_at)

    # --- the Robot Server ---------------------------------------------------------------------------------------

    def _datagram(
        self,
        system_state: SystemState,
        datagram: Own,
        sender: Address = KRC_AT,
        a: int | None = None,
        s: int | None = None,
        takes: bool = True,
    ) -> SystemState:
        """A datagram arrives, and is answered at once."""
        line, who, measured, answer = _line(system_state).read(
            self._program, datagram, sender, system_state.ticks
        )
        heard = not _line(system_state).is_silent(system_state.ticks)
        kept_out = sender == STRANGER_AT or (
            sender == SECOND_AT and heard and _line(system_state).peer.address == KRC_AT
        )
        if kept_out and who is DatagramSource.KRC:
            raise Violation(Property.UNHEARD, f"a datagram from {sender} was read")
        if who is not DatagramSource.KRC:
            return system_state
        system_state = replace(system_state, line=line)
        if measured is not None:
            system_state, answer = self._measured(system_state, measured, a, s)
        if answer is not None and takes and sender == KRC_AT:
            system_state = replace(system_state, line=_taken(_line(system_state), answer))
        return system_state

    def _measured(
        self, system_state: SystemState, measured: Measurement, a: int | None, s: int | None
    ) -> tuple[SystemState, Own]:
        line, before = _line(system_state), system_state.server.state
        admission = system_state.admissions[a] if a is not None else None
        sent = system_state.supervisions[s] if s is not None else None
        server = self._server
        server.restore(system_state.server)
        q_cmd = server.cycle(
            measured, float(system_state.ticks), admission, sent.message if sent is not None else None
        )
        line, answer = line.replied(self._program, q_cmd)
        driver, _ = self._program
        if driver.fault is not None:
            raise Violation(Property.CERTIFIED, f"the guard refused a reply: {driver.fault}")
        assert server.state is not None  # every cycle publishes one
        after, begins = server.state, measured.q_start is not None
        telegram = Telegram(
            before=before,
            after=after,
            admissions=at_hand(system_state, admission),
            order_of_stop=sent is not None and sent.order_of_stop,
            gate_heard=sent is not None,
            missed=measured.missed_last,
            begins=begins,
        )
        monitor = system_state.monitor.telegram(telegram)
        used = system_state.used.server_took(before, after)
        if not begins:
            judge_course(system_state.gate.robots[ROBOT].tracker, float(q_cmd[0]), monitor.course)
        pending = line.pending
        if before is not None and before.q_reset is not None and after.q_reset is None:
            if abs(after.q_cmd[0] - line.krc.stands) > _TOLD and not pending:
                raise Violation(
                    Property.EXPLAINED,
                    f"a reset took {after.q_cmd[0]:g}, the KRC stands at {line.krc.stands:g}",
                )
        elif before is not None and after.q_cmd != before.q_cmd and after.q_reset is None:
            so_far = pending[-1] if pending else 0.0
            pending = (*pending, so_far + after.q_cmd[0] - before.q_cmd[0])
        system_state = replace(
            system_state,
            server=server.snapshot(),
            q=float(measured.q[0]),
            states=(*system_state.states, SentState(after, silent=False))[-KEPT:],
            new_admission=system_state.new_admission and a is None,
            new_supervision=system_state.new_supervision and s is None,
            monitor=monitor,
            used=used,
            line=replace(line, heard=system_state.ticks, pending=pending),
        )
        return system_state, answer

    def _server_crash(self, system_state: SystemState) -> SystemState:
        line = _line(system_state)
        crashed = super()._server_crash(system_state)
        anew = replace(line, driver=self._blank_driver, peer=self._blank_peer, heard=system_state.ticks)
        return replace(crashed, line=anew)


def _line(system_state: SystemState) -> RsiLine:
    assert system_state.line is not None  # every moment of this system has one
    return system_state.line


def _attack(act: Act) -> Act:
    """The same, at the cost of one attack."""

    def costly(system_state: SystemState) -> SystemState:
        line = _line(system_state)
        return act(replace(system_state, line=replace(line, attacks_left=line.attacks_left - 1)))

    return costly


def _posing(system_state: SystemState, at: Address) -> SystemState:
    line = _line(system_state)
    return replace(system_state, line=replace(line, clock=line.krc.ipoc + 2 * _FAR, poses_at=at))


def _taken(line: RsiLine, answer: Own) -> RsiLine:
    """The KRC takes an answer to its newest telegram, once; it must not be moved by it but as was certified."""
    krc = line.krc
    if answer.ipoc != krc.ipoc or krc.answered:
        return line
    moved = answer.q - krc.correction
    for number, certified in enumerate(line.pending):
        if abs(moved - certified) <= _TOLD:
            left = tuple(later - certified for later in line.pending[number + 1 :])
            return replace(line, krc=krc._replace(correction=answer.q, answered=True), pending=left)
    if abs(moved) > _TOLD:
        raise Violation(
            Property.EXPLAINED, f"the KRC was moved by {moved / STEP:g} steps, certified are {line.pending}"
        )
    return replace(line, krc=krc._replace(answered=True))
