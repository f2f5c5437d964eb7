"""One moment of the composed system: both programs, what is in flight between them, and what is owed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from deltaq_proofs.model_checker.one_joint import (
    CYCLE_S,
    GATE_TIMEOUT_CYCLES,
    HLI_TIMEOUT_CYCLES,
    IPOC_STEP,
    KRC_TIMEOUT_CYCLES,
    ROBOT,
    STEP,
)
from deltaq_proofs.model_checker.rsi_line import Own, RsiLine
from deltaq_proofs.model_checker.safety_monitor import SafetyMonitor
from deltaq_proofs.model_checker.used_requests import UsedRequests
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, GateMemory, Request, ServerState, Supervision
from deltaq_protocol.rsi import KrcTelegram
from deltaq_services.robot_server.core import RobotServer

_TICKS_APART = 4
"""No age is judged that is greater, in cycles."""
_IPOCS_APART = 110
"""Nor a distance of two IPOCs, in cycles."""
_DELAYS_APART = 1
"""Of late packets it is asked only whether there are more."""


def line_key(line: RsiLine, tick: int, place: Callable[[float], int]) -> tuple[Any, ...]:
    """IPOCs by their order and distance, times by their age, places in steps from the setpoint, as `place` tells."""
    driver, session, krc = line.driver, line.driver.session, line.krc
    last, run = session.last, session._run
    newest = None if run is None else run.newest
    own = [one for one in (line.sent, line.overtaken) if one is not None]
    read = [one for one in (last, newest) if one is not None]
    ipocs = [krc.ipoc, *(one.ipoc for one in own), *(one.ipoc for one in read)]
    if line.clock is not None:
        ipocs.append(line.clock)
    ipoc = ranks(ipocs, _IPOCS_APART * IPOC_STEP)
    delays = [krc.delay, *(one.delay for one in own), *(one.delay or 0 for one in read)]
    delay = ranks(delays, _DELAYS_APART)

    def age(time_s: float) -> int:
        cycles = round(2 * (tick * CYCLE_S - time_s) / CYCLE_S)
        return min(cycles, 2 * _TICKS_APART)

    def of_own(one: Own | None) -> tuple[int, ...] | None:
        return (
            None if one is None else (ipoc[one.ipoc], place(one.q), place(one.programmed), delay[one.delay])
        )

    def of_read(one: KrcTelegram | None) -> tuple[int, ...] | None:
        if one is None or one.q is None or one.q_programmed is None:
            return None
        return (ipoc[one.ipoc], place(one.q[0]), place(one.q_programmed[0]), delay[one.delay or 0])

    def of_array(value: Array | None) -> int | None:
        return None if value is None else place(float(value[0]))

    zero = place(0.0)
    sent, origin = driver._sent, driver._origin
    return (
        line.attacks_left,
        (ipoc[krc.ipoc], place(krc.programmed), place(krc.stands), krc.answered, delay[krc.delay]),
        min(tick - line.heard, _TICKS_APART),
        tuple(place(step) - zero for step in line.pending),
        of_own(line.sent) if line.attacks_left else None,
        of_own(line.overtaken),
        line.silent,
        None if line.clock is None else (ipoc[line.clock], line.poses_at, line.posed),
        (session.belief, session.step, of_read(last), age(session._time_s)),
        None if run is None else (run.count, run.step, age(run.first_s), of_read(newest)),
        tuple((of_array(earlier), of_array(earlier + there)) for earlier, there in driver._earlier),
        (
            of_array(origin),
            None if origin is None or sent is None else of_array(origin + sent),
            driver._opened,
        ),
        (line.peer.address, age(line.peer._heard_s)),
    )


def ranks(numbers: Sequence[int], apart: int) -> dict[int, int]:
    """Numbers by their order and their distance, distances above `apart` taken for equal."""
    ranks: dict[int, int] = {}
    rank, last = 0, None
    for number in sorted(set(numbers)):
        rank += 0 if last is None else min(number - last, apart)
        ranks[number] = rank
        last = number
    return ranks


KEPT = 2
"""Messages of a kind that may be under way at once; older ones are lost for good."""

_CYCLES_APART = 4
"""Cycle numbers further apart than this are told apart, but not by how much: no age that is judged is greater."""

_STEPS_APART = 40
"""Nor are places further from the setpoint: no robot comes back to one before what was sent there is out of date."""

_PAST_TIMEOUT = 1 + max(GATE_TIMEOUT_CYCLES, KRC_TIMEOUT_CYCLES, HLI_TIMEOUT_CYCLES)
"""A count of silent cycles says nothing more from here on."""


class Turn(StrEnum):
    """Who acts next; one round is one cycle of the robot."""

    TELEGRAM = "telegram"
    STATE = "state"
    HLI = "hli"


@dataclass(frozen=True, slots=True)
class SentState:
    """A state in flight, and whether it tells that the KRC is silent."""

    message: ServerState
    silent: bool


@dataclass(frozen=True, slots=True)
class SentSupervision:
    """A heartbeat in flight, and whether the gate had taken a stop when it sent it."""

    message: Supervision
    order_of_stop: bool


@dataclass(frozen=True, slots=True)
class SystemState:
    """A moment. What is in flight stays for others to duplicate, delay or put before what is newer.

    Attributes:
        server: a snapshot of the Robot Server.
        gate: the memory of the SIM.
        turn: who acts next.
        faults_left: how many more faults may happen.
        ticks: rises with every telegram or silence.
        q: where the KRC was last known to stand [m].
        displaced: the robot is off the path that was commanded.
        states, admissions, supervisions: in flight, newest last.
        new_admission, new_supervision: the newest was sent since the last telegram.
        monitor: what is owed.
        used: which request stands behind which admission.
        line: RSI's wire, where it is one that may be attacked.
    """

    server: RobotServer
    gate: GateMemory
    turn: Turn
    faults_left: int
    ticks: int
    q: float
    displaced: bool
    states: tuple[SentState, ...]
    admissions: tuple[Admission, ...]
    supervisions: tuple[SentSupervision, ...]
    new_admission: bool
    new_supervision: bool
    monitor: SafetyMonitor
    used: UsedRequests
    line: RsiLine | None = None

    def key(self) -> tuple[Any, ...]:
        """What tells this moment from others, apart from the faults left.

        Numbers that only count up (cycles, sequences, resets, time) and the place of the robot are told by how they
        compare with one another, because the programs do nothing else with them. Without a fault left, what was not
        delivered in its turn never will be, and tells nothing.
        """
        if self.faults_left:
            return _Key(self).of_world()
        due = replace(
            self,
            states=self.states[-1:] if self.turn is Turn.STATE else (),
            admissions=self.admissions[-1:] if self.new_admission else (),
            supervisions=self.supervisions[-1:] if self.new_supervision else (),
        )
        return _Key(due).of_world()


class _Key:
    def __init__(self, system_state: SystemState) -> None:
        self._system_state = system_state
        gate = system_state.gate.robots[ROBOT]
        state = gate.tracker.state
        states = [sent.message for sent in system_state.states]
        states += [one for one in (state, system_state.server.state) if one is not None]
        admissions = [*system_state.admissions]
        admissions += [*gate.tracker.in_flight, *system_state.server.waiting]
        cycles = [-1, 0, gate.decided_cycle, *(s.cycle for s in states), *(a.cycle for a in admissions)]
        for request in (gate.waiting, gate.decided):
            if request is not None:
                cycles += [request.cycle, request.cycle if request.newest is None else request.newest]
        self._cycle = ranks(cycles, _CYCLES_APART)
        sequences = [0, system_state.gate.sequence, *(s.sequence for s in states)]
        for admission in admissions:
            sequences += [admission.sequence, admission.follows_sequence]
        self._sequence = ranks(sequences, 1)
        resets = [0, gate.orders.resets, system_state.server._resets, *(s.resets for s in states)]
        resets += [admission.follows_resets for admission in admissions]
        self._resets = ranks([*resets, *(sent.message.resets for sent in system_state.supervisions)], 2)
        self._process = ranks([s.process for s in states], 1)
        self._time = ranks([round(s.time_s) for s in states], 1)
        self._place = (
            system_state.server.state.q_cmd[0] if system_state.server.state is not None else system_state.q
        )

    def of_world(self) -> tuple[Any, ...]:
        system_state, server = self._system_state, self._system_state.server
        gate = system_state.gate.robots[ROBOT]
        state, silent = gate.tracker.state, gate.orders.cycles_without_hli
        return (
            system_state.turn,
            system_state.displaced,
            self._q(system_state.q),
            system_state.new_admission,
            system_state.new_supervision,
            system_state.monitor,
            min(server._cycles_without_gate, _PAST_TIMEOUT),
            min(server._cycles_missed, _PAST_TIMEOUT),
            server._settling.cycles_at_rest,
            None if server._settling.q_settled is None else self._q(server._settling.q_settled[0]),
            server.motion_stop,
            self._resets[server._resets],
            self._state(server.state),
            (system_state.gate.epoch, self._sequence[system_state.gate.sequence]),
            self._state(state),
            tuple(self._admission(admission) for admission in gate.tracker.in_flight),
            tuple(self._admission(admission) for admission in server.waiting),
            tuple(self._q(setpoint[0]) for setpoint in gate.tracker.history),
            tuple(self._process[one] for one in gate.tracker.ended_processes if one in self._process),
            gate.orders.standing_stop,
            self._resets[gate.orders.resets],
            None if silent is None else min(silent, _PAST_TIMEOUT),
            gate.orders.krc_silent,
            self._cycle[gate.decided_cycle],
            # spoken in any cycle before the newest is the same
            None if state is None else max(gate.spoken_cycle - state.cycle, -1),
            self._request(gate.waiting),
            self._request(gate.decided),
            system_state.used.key(
                (*system_state.admissions, *server.waiting), (gate.waiting or gate.decided) is not None
            ),
            tuple((self._state(sent.message), sent.silent) for sent in system_state.states),
            tuple(self._admission(admission) for admission in system_state.admissions),
            tuple(
                (sent.message.epoch, sent.message.stop, self._resets[sent.message.resets], sent.order_of_stop)
                for sent in system_state.supervisions
            ),
            None if system_state.line is None else line_key(system_state.line, system_state.ticks, self._q),
        )

    def _q(self, value: float) -> int:
        steps = round((value - self._place) / STEP)
        return max(-_STEPS_APART, min(steps, _STEPS_APART))

    def _state(self, state: ServerState | None) -> tuple[Any, ...] | None:
        if state is None:
            return None
        return (
            self._process[state.process],
            self._cycle[state.cycle],
            self._time[round(state.time_s)],
            self._q(state.q[0]),
            self._q(state.q_cmd[0]),
            None if state.q_reset is None else self._q(state.q_reset[0]),
            state.dq,
            (state.plan.dq, state.plan.brake_cycles, state.plan.step),
            (state.epoch, self._sequence[state.sequence], self._resets[state.resets]),
            (state.phase, state.reason),
        )

    def _request(self, request: Request | None) -> tuple[Any, ...] | None:
        if request is None:
            return None
        newest = request.cycle if request.newest is None else request.newest
        return (self._cycle[request.cycle], self._cycle[newest], request.dq)

    def _admission(self, admission: Admission) -> tuple[Any, ...]:
        return (
            admission.epoch,
            self._sequence[admission.sequence],
            self._cycle[admission.cycle],
            self._sequence[admission.follows_sequence],
            self._q(admission.follows_q_cmd[0]),
            admission.follows_dq,
            self._resets[admission.follows_resets],
            admission.dq,
        )
