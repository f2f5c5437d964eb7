"""What can happen next: every move of the KRC, the wires, the gate and the HLI from a given moment.

Robot Server and SIM are the services' own code. The KRC is a clock that may miss, fall silent, begin anew or be
pushed off its path, and its wire is benign; `attacked` has one that is not. Both programs may crash and start anew.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate

import numpy as np

from deltaq_proofs.model_checker.gate_side import Act, GateSide
from deltaq_proofs.model_checker.one_joint import ROBOT, STEP
from deltaq_proofs.model_checker.safety_monitor import Property, SafetyMonitor, Telegram, Violation
from deltaq_proofs.model_checker.system_state import KEPT, SentState, SystemState, Turn
from deltaq_proofs.model_checker.used_requests import UsedRequests
from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import Admission, ServerState, TrackerMemory
from deltaq_protocol.messages import Phase
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement

_PUSHED = 32 * STEP
"""How far a robot is pushed off its path: more than it may be off [m]."""


@dataclass(frozen=True, slots=True)
class Move:
    """Something that happens, and what comes of it: the next moment, or a property that does not hold."""

    what: str
    system_state: SystemState | None
    violation: Violation | None = None


class System(GateSide):
    """Robot Server and SIM, and all that can happen to them.

    Args:
        lookahead_cycles: how many cycles ahead the SIM decides.
    """

    def __init__(self, lookahead_cycles: int = 1) -> None:
        super().__init__(lookahead_cycles)
        self._server = self._new_server(process=1)
        self._blank_server = self._server.snapshot()

    def _new_server(self, process: int) -> RobotServer:
        return RobotServer(self._description, ROBOT, process)

    def start(self, faults: int) -> SystemState:
        """The first moment, with at most so many faults to come."""
        return SystemState(
            server=self._blank_server,
            gate=self._blank,
            turn=Turn.TELEGRAM,
            faults_left=faults,
            ticks=0,
            q=0.0,
            displaced=False,
            states=(),
            admissions=(),
            supervisions=(),
            new_admission=False,
            new_supervision=False,
            monitor=SafetyMonitor(),
            used=UsedRequests(),
        )

    def moves(self, system_state: SystemState) -> Iterator[Move]:
        """Everything that can happen next."""
        turns = {Turn.TELEGRAM: self._telegrams, Turn.STATE: self.states, Turn.HLI: self.hli}
        for what, faults, act in turns[system_state.turn](system_state):
            if faults > system_state.faults_left:
                continue
            try:
                yield Move(what, act(replace(system_state, faults_left=system_state.faults_left - faults)))
            except Violation as violation:
                yield Move(what, None, violation)

    # --- the KRC and the Robot Server ---------------------------------------------------------------------

    def _telegrams(self, system_state: SystemState) -> Iterator[tuple[str, int, Act]]:
        admission = len(system_state.admissions) - 1 if system_state.new_admission else None
        supervision = len(system_state.supervisions) - 1 if system_state.new_supervision else None
        for a in (None, *range(len(system_state.admissions))):
            for s in (None, *range(len(system_state.supervisions))):
                what = f"telegram with {_which(a, 'admission', system_state.admissions)} and "
                what += _which(s, "heartbeat", system_state.supervisions)
                faults = (a != admission) + (s != supervision)
                yield what, faults, partial(self._telegram, a=a, s=s)
        if system_state.server.state is not None:
            yield (
                "telegram that tells of a missed reply",
                1,
                lambda w: self._telegram(w, admission, supervision, missed=True),
            )
            yield "the KRC falls silent", 1, self._silence
            yield (
                "the KRC begins a new session",
                1,
                lambda w: self._telegram(w, admission, supervision, begins=True),
            )
            yield "the Robot Server crashes", 1, self._server_crash
        if system_state.displaced:
            yield "the robot is put back", 0, lambda w: replace(w, displaced=False)
        else:
            yield "the robot is pushed off its path", 1, lambda w: replace(w, displaced=True)

    def _telegram(
        self,
        system_state: SystemState,
        a: int | None,
        s: int | None,
        missed: bool = False,
        begins: bool = False,
    ) -> SystemState:
        before = system_state.server.state
        begins = begins or before is None
        admission = system_state.admissions[a] if a is not None else None
        sent = system_state.supervisions[s] if s is not None else None
        q = system_state.q if missed or before is None else _sent(before)
        measured = np.array([q + (_PUSHED if system_state.displaced and not begins else 0.0)])
        server = self._server
        server.restore(system_state.server)
        server.cycle(
            Measurement(system_state.ticks, measured, measured if begins else None, missed),
            float(system_state.ticks),
            admission,
            sent.message if sent is not None else None,
        )
        assert server.state is not None  # every cycle publishes one
        telegram = Telegram(
            before=before,
            after=server.state,
            admissions=at_hand(system_state, admission),
            order_of_stop=sent is not None and sent.order_of_stop,
            gate_heard=sent is not None,
            missed=missed,
            begins=begins,
        )
        monitor = system_state.monitor.telegram(telegram)
        used = system_state.used.server_took(before, server.state)
        if not begins:
            judge_course(system_state.gate.robots[ROBOT].tracker, _sent(server.state), monitor.course)
        return replace(
            system_state,
            server=server.snapshot(),
            turn=Turn.STATE,
            ticks=system_state.ticks + 1,
            q=q if not begins else float(measured[0]),
            displaced=system_state.displaced and not begins,  # a session begins where the robot is
            states=(*system_state.states, SentState(server.state, silent=False))[-KEPT:],
            new_admission=False,
            new_supervision=False,
            monitor=monitor,
            used=used,
        )

    def _silence(self, system_state: SystemState) -> SystemState:
        server = self._server
        server.restore(system_state.server)
        server.krc_silent(float(system_state.ticks))
        assert server.state is not None  # silence is not offered before the first state
        if server.state.phase not in (Phase.HELD, Phase.OFFLINE):
            raise Violation(Property.NOTICED, f"{server.state.phase} though the KRC is silent")
        states = (*system_state.states, SentState(server.state, silent=True))[-KEPT:]
        return replace(
            system_state,
            server=server.snapshot(),
            turn=Turn.STATE,
            ticks=system_state.ticks + 1,
            states=states,
            monitor=system_state.monitor.krc_silent(),
        )

    def _server_crash(self, system_state: SystemState) -> SystemState:
        assert system_state.server.state is not None  # a crash is not offered before the first state
        successor = self._blank_server.snapshot()
        successor.process = system_state.server.process + 1
        return replace(
            system_state,
            server=successor,
            q=_sent(system_state.server.state),
            new_admission=False,
            new_supervision=False,
            monitor=system_state.monitor.server_crashed(system_state.server.state.phase is Phase.OFFLINE),
        )


def at_hand(system_state: SystemState, handed: Admission | None) -> tuple[Admission, ...]:
    """What a Robot Server has: what was handed to it before and is not due yet, and now."""
    kept = system_state.server.waiting
    return kept if handed is None else (*kept, handed)


def _sent(state: ServerState) -> float:
    """Where the KRC was sent last [m]."""
    return (state.q_cmd if state.q_reset is None else state.q_reset)[0]


def _which(index: int | None, what: str, under_way: tuple[object, ...]) -> str:
    if index is None:
        return f"no {what}"
    return f"the newest {what}" if index == len(under_way) - 1 else f"an older {what}"


def judge_course(gate: TrackerMemory, q_cmd: float, course: tuple[float, ...]) -> None:
    """Hold the setpoint and the course after it against what the gate believes.

    The gate certifies the motion of one robot against every course that it believes the other may take. That is sound
    only if the true course is among them, or lies within them, whatever was lost on the way.

    Args:
        gate: what the gate remembers of the robot.
        q_cmd: the setpoint just sent [m].
        course: increments still to be sent [m].

    Raises:
        Violation: if the robot is, or will be, outside the courses that the gate believes possible.
    """
    if gate.state is None:
        return
    history = [setpoint[0] for setpoint in gate.history]
    plan, here = gate.state.plan, history[-1]
    believed = [*history, *_places(here, plan.dq, plan.brake_cycles, plan.step + 1)]
    for flight in gate.in_flight:
        believed += _places(flight.follows_q_cmd[0], flight.dq, flight.brake_cycles, 0)
    for place in accumulate(course, initial=q_cmd):
        if not min(believed) <= place <= max(believed):
            raise Violation(
                Property.KNOWN,
                f"the robot comes to {place:g}, the gate believes {min(believed):g} to {max(believed):g}",
            )


def _places(q_cmd: float, dq: tuple[float, ...], brake_cycles: int, step: int) -> Iterator[float]:
    """The setpoints of a brake from one of its steps on."""
    increments = (
        float(brake_increment(np.array(dq), brake_cycles, k)[0]) for k in range(step, brake_cycles + 1)
    )
    return accumulate(increments, initial=q_cmd)
