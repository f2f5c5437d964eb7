"""What can happen next: every move of the KRC, the wires, the gate and the HLI from a given moment.

Robot Server and SIM are the services' own code. The KRC is a clock that may miss, fall silent, begin anew or be
pushed off its path; the HLI is anybody who may send requests and commands; each wire may lose, keep back, double and
reorder; both programs may crash and restart.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from deltaq_experiments.model import course
from deltaq_experiments.model.ledger import Ledger, Property, Telegram, Violation
from deltaq_experiments.model.one_joint import (
    CYCLE_S,
    FASTEST,
    HLI_TIMEOUT_CYCLES,
    LAG_CYCLES,
    ROBOT,
    STEP,
    one_joint_cell,
    one_joint_sim,
)
from deltaq_experiments.model.world import SentState, SentSupervision, Turn, World
from deltaq_protocol.guarded import (
    Admission,
    Command,
    CommandReply,
    GateMemory,
    Request,
    ServerState,
    Supervision,
)
from deltaq_protocol.messages import Message, Phase
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.answers import Output
from deltaq_services.sim.core import Sim
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker

Act = Callable[[World], World]
_Kind = Literal["stop", "reset"]
_KINDS: tuple[_Kind, ...] = ("stop", "reset")

_KEPT = 2
"""Messages of a kind that may be in flight at once; older ones are lost for good."""

_PUSHED = 32 * STEP
"""How far a robot is pushed off its path: more than it may be off [m]."""


@dataclass(frozen=True, slots=True)
class Move:
    """Something that happens, and what comes of it: the next moment, or a property that does not hold."""

    what: str
    world: World | None
    violation: Violation | None = None


class System:
    """Robot Server and SIM, and all that can happen to them."""

    def __init__(self) -> None:
        self._description = one_joint_cell()
        self._sim = self._new_sim()
        self._blank = self._sim.memory()

    def _new_sim(self) -> Sim:
        return one_joint_sim(self._description)

    def _new_server(self, process: int) -> RobotServer:
        return RobotServer(self._description, ROBOT, process)

    def _sim_with(self, tracker_type: type[Tracker], orders_type: type[Orders]) -> Sim:
        """A SIM that follows its robot and orders it about with these."""
        sim = one_joint_sim(self._description)
        tracker = tracker_type(ROBOT, self._description.robots[ROBOT], CYCLE_S, LAG_CYCLES)
        sim.robots[ROBOT].tracker = tracker
        sim.robots[ROBOT].orders = orders_type(tracker, HLI_TIMEOUT_CYCLES)
        return sim

    def start(self, faults: int) -> World:
        """The first moment, with at most so many faults to come."""
        return World(
            server=self._new_server(process=1),
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
            ledger=Ledger(),
        )

    def moves(self, world: World) -> Iterator[Move]:
        """Everything that can happen next."""
        turns = {Turn.TELEGRAM: self._telegrams, Turn.STATE: self._states, Turn.HLI: self._hli}
        for what, faults, act in turns[world.turn](world):
            if faults > world.faults_left:
                continue
            try:
                yield Move(what, act(replace(world, faults_left=world.faults_left - faults)))
            except Violation as violation:
                yield Move(what, None, violation)

    # --- the KRC and the Robot Server ---------------------------------------------------------------------

    def _telegrams(self, world: World) -> Iterator[tuple[str, int, Act]]:
        admission = len(world.admissions) - 1 if world.new_admission else None
        supervision = len(world.supervisions) - 1 if world.new_supervision else None
        for a in (None, *range(len(world.admissions))):
            for s in (None, *range(len(world.supervisions))):
                what = f"telegram with {_which(a, 'admission', world.admissions)} and "
                what += _which(s, "heartbeat", world.supervisions)
                faults = (a != admission) + (s != supervision)
                yield what, faults, partial(self._telegram, a=a, s=s)
        if world.server.state is not None:
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
        if world.displaced:
            yield "the robot is put back", 0, lambda w: replace(w, displaced=False)
        else:
            yield "the robot is pushed off its path", 1, lambda w: replace(w, displaced=True)

    def _telegram(
        self, world: World, a: int | None, s: int | None, missed: bool = False, begins: bool = False
    ) -> World:
        before = world.server.state
        begins = begins or before is None
        admission = world.admissions[a] if a is not None else None
        sent = world.supervisions[s] if s is not None else None
        q = world.q if missed or before is None else _sent(before)
        measured = np.array([q + (_PUSHED if world.displaced and not begins else 0.0)])
        server = _copied(world.server)
        server.cycle(
            Measurement(world.ticks, measured, measured if begins else None, missed),
            float(world.ticks),
            admission,
            sent.message if sent is not None else None,
        )
        assert server.state is not None  # every cycle publishes one
        told = Telegram(
            before=before,
            after=server.state,
            admission=admission,
            order_of_stop=sent is not None and sent.order_of_stop,
            gate_heard=sent is not None,
            missed=missed,
            begins=begins,
        )
        ledger = world.ledger.telegram(told)
        if not begins:
            course.judge(world.gate.robots[ROBOT].tracker, _sent(server.state), ledger.course)
        return replace(
            world,
            server=server,
            turn=Turn.STATE,
            ticks=world.ticks + 1,
            q=q if not begins else float(measured[0]),
            displaced=world.displaced and not begins,  # a session begins where the robot is
            states=(*world.states, SentState(server.state, silent=False))[-_KEPT:],
            new_admission=False,
            new_supervision=False,
            ledger=ledger,
        )

    def _silence(self, world: World) -> World:
        server = _copied(world.server)
        server.krc_silent(float(world.ticks))
        assert server.state is not None  # silence is not offered before the first state
        if server.state.phase not in (Phase.HELD, Phase.OFFLINE):
            raise Violation(Property.NOTICED, f"{server.state.phase} though the KRC is silent")
        states = (*world.states, SentState(server.state, silent=True))[-_KEPT:]
        return replace(
            world,
            server=server,
            turn=Turn.STATE,
            ticks=world.ticks + 1,
            states=states,
            ledger=world.ledger.krc_silent(),
        )

    def _server_crash(self, world: World) -> World:
        assert world.server.state is not None  # a crash is not offered before the first state
        return replace(
            world,
            server=self._new_server(world.server.process + 1),
            q=_sent(world.server.state),
            new_admission=False,
            new_supervision=False,
            ledger=world.ledger.server_crashed(world.server.state.phase is Phase.OFFLINE),
        )

    # --- states on their way to the gate --------------------------------------------------------------------

    def _states(self, world: World) -> Iterator[tuple[str, int, Act]]:
        yield "the gate takes the state", 0, lambda w: self._take_states(w, -1)
        for kind in _KINDS:
            yield (
                f"{kind}, then the gate takes the state",
                0,
                partial(self._commanded_first, kind=kind),
            )
        yield "the state is late or lost", 1, self._take_states
        yield "the gate takes the state twice", 1, lambda w: self._take_states(w, -1, -1)
        if len(world.states) == _KEPT:
            yield "the gate takes the state before again", 1, lambda w: self._take_states(w, -2)
            yield "the gate takes both states, the newer first", 1, lambda w: self._take_states(w, -1, -2)
            yield "the gate takes the state before, then the newer", 1, lambda w: self._take_states(w, -2, -1)
        yield "the gate crashes and starts anew", 1, self._gate_crash

    def _take_states(self, world: World, *which: int) -> World:
        for index in which:
            sent = world.states[index]
            known = world.gate.robots[ROBOT].tracker.state
            if known is None or sent.message.time_s >= known.time_s:
                # silence shows by a state that repeats a cycle; the first of a cycle may be the only one that came
                repeats = known is not None and sent.message.cycle == known.cycle
                world = replace(world, ledger=replace(world.ledger, silence_told=sent.silent and repeats))
            world = self._gate_takes(world, sent.message)
        return replace(world, turn=Turn.HLI)

    def _gate_crash(self, world: World) -> World:
        blank = self._blank.model_copy(update={"epoch": world.gate.epoch + 1})
        assert world.server.state is not None  # it has just published one
        offline = world.server.state.phase is Phase.OFFLINE
        return replace(world, gate=blank, turn=Turn.HLI, ledger=world.ledger.gate_crashed(offline))

    # --- the HLI ----------------------------------------------------------------------------------------------

    def _hli(self, world: World) -> Iterator[tuple[str, int, Act]]:
        yield "the HLI says nothing", 0, lambda w: replace(w, turn=Turn.TELEGRAM)
        state = world.gate.robots[ROBOT].tracker.state
        cycle = state.cycle if state is not None else 0
        yield (
            "the HLI gives a heartbeat",
            0,
            lambda w: self._asks(w, Request(robot=ROBOT, cycle=cycle, lease_epoch=1)),
        )
        if state is not None:
            now = round(state.dq[0] / STEP)
            for steps in range(max(0, now - 1), min(FASTEST, now + 1) + 1):
                yield f"request for {steps}", 0, partial(self._requested, cycle=cycle, steps=steps)
            yield (
                "request that overtakes the state it answers",
                1,
                lambda w: self._asks(w, _request(w, cycle + 1, min(FASTEST, now + 1))),
            )
        for kind in _KINDS:
            yield kind, 0, partial(self._commanded_after, kind=kind)

    def _asks(self, world: World, request: Request) -> World:
        return replace(self._gate_takes(world, request), turn=Turn.TELEGRAM)

    def _requested(self, world: World, cycle: int, steps: int) -> World:
        return self._asks(world, _request(world, cycle, steps))

    def _commanded_after(self, world: World, kind: _Kind) -> World:
        return replace(self._command(world, kind), turn=Turn.TELEGRAM)

    def _commanded_first(self, world: World, kind: _Kind) -> World:
        return self._take_states(self._command(world, kind), -1)

    def _command(self, world: World, kind: _Kind) -> World:
        state = world.gate.robots[ROBOT].tracker.state
        command = Command(
            id=world.gate.command_id + 1,
            kind=kind,
            epoch=world.gate.epoch,
            cycles={} if state is None else {ROBOT: state.cycle},
            robot=ROBOT,
        )
        return self._gate_takes(world, command)

    # --- the gate ---------------------------------------------------------------------------------------------

    def _gate_takes(self, world: World, message: Message) -> World:
        self._sim.recall(world.gate)
        outputs = self._sim.take(message)
        ledger, admissions, supervisions = world.ledger, world.admissions, world.supervisions
        new_admission, new_supervision = world.new_admission, world.new_supervision
        if isinstance(message, Command):
            ledger = _commanded(ledger, message, outputs, world.gate)
            if ledger.since_stop is None:
                supervisions = tuple(replace(sent, order_of_stop=False) for sent in supervisions)
        for output in outputs:
            if isinstance(output.message, Admission):
                admissions, new_admission = (*admissions, output.message)[-_KEPT:], True
            elif isinstance(output.message, Supervision):
                sent = SentSupervision(output.message, ledger.since_stop is not None)
                supervisions, new_supervision = (*supervisions, sent)[-_KEPT:], True
        return replace(
            world,
            gate=self._sim.memory(),
            ledger=ledger,
            admissions=admissions,
            supervisions=supervisions,
            new_admission=new_admission,
            new_supervision=new_supervision,
        )


def _commanded(ledger: Ledger, command: Command, outputs: list[Output], gate: GateMemory) -> Ledger:
    if command.kind == "stop":
        return ledger.stop_taken()
    refused = any(isinstance(o.message, CommandReply) and not o.message.accepted for o in outputs)
    believed = gate.robots[ROBOT].tracker.state
    return ledger if refused or believed is None else ledger.reset_accepted(believed)


def _request(world: World, cycle: int, steps: int) -> Request:
    seq = world.gate.robots[ROBOT].seq + 1
    return Request(robot=ROBOT, cycle=cycle, lease_epoch=1, seq=seq, dq=(steps * STEP,))


def _sent(state: ServerState) -> float:
    """Where the KRC was sent last [m]."""
    return (state.q_cmd if state.q_reset is None else state.q_reset)[0]


def _copied(server: RobotServer) -> RobotServer:
    """A server that goes its own way; its arrays are replaced, never written to."""
    copied = copy.copy(server)
    copied.counters, copied.outputs = Counter(), dict(server.outputs)
    return copied


def _which(index: int | None, what: str, under_way: tuple[object, ...]) -> str:
    if index is None:
        return f"no {what}"
    return f"the newest {what}" if index == len(under_way) - 1 else f"an older {what}"
