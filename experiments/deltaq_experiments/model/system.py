"""What can happen next: every move of the KRC, the wires, the gate and the HLI from a given moment.

Robot Server and SIM are the services' own code. The KRC is a clock that may miss, fall silent, begin anew or be
pushed off its path, and its wire is benign; `attacked` has one that is not. Both programs may crash and start anew.
"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from deltaq_experiments.model import course
from deltaq_experiments.model.gate_side import Act, GateSide
from deltaq_experiments.model.ledger import Ledger, Property, Telegram, Violation
from deltaq_experiments.model.one_joint import ROBOT, STEP
from deltaq_experiments.model.world import KEPT, SentState, Turn, World
from deltaq_protocol.guarded import ServerState
from deltaq_protocol.messages import Phase
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement

_PUSHED = 32 * STEP
"""How far a robot is pushed off its path: more than it may be off [m]."""


@dataclass(frozen=True, slots=True)
class Move:
    """Something that happens, and what comes of it: the next moment, or a property that does not hold."""

    what: str
    world: World | None
    violation: Violation | None = None


class System(GateSide):
    """Robot Server and SIM, and all that can happen to them."""

    def _new_server(self, process: int) -> RobotServer:
        return RobotServer(self._description, ROBOT, process)

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
        turns = {Turn.TELEGRAM: self._telegrams, Turn.STATE: self.states, Turn.HLI: self.hli}
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
        server = copied(world.server)
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
            states=(*world.states, SentState(server.state, silent=False))[-KEPT:],
            new_admission=False,
            new_supervision=False,
            ledger=ledger,
        )

    def _silence(self, world: World) -> World:
        server = copied(world.server)
        server.krc_silent(float(world.ticks))
        assert server.state is not None  # silence is not offered before the first state
        if server.state.phase not in (Phase.HELD, Phase.OFFLINE):
            raise Violation(Property.NOTICED, f"{server.state.phase} though the KRC is silent")
        states = (*world.states, SentState(server.state, silent=True))[-KEPT:]
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


def _sent(state: ServerState) -> float:
    """Where the KRC was sent last [m]."""
    return (state.q_cmd if state.q_reset is None else state.q_reset)[0]


def copied(server: RobotServer) -> RobotServer:
    """A server that goes its own way; its arrays are replaced, never written to."""
    other = copy.copy(server)
    other.counters, other.outputs = Counter(), dict(server.outputs)
    return other


def _which(index: int | None, what: str, under_way: tuple[object, ...]) -> str:
    if index is None:
        return f"no {what}"
    return f"the newest {what}" if index == len(under_way) - 1 else f"an older {what}"
