"""What can happen between Robot Server and gate, at the gate, and between HLI and gate.

The gate is the SIM's own code. Each wire may lose, keep back, double and reorder; the HLI is anybody who may send
requests and commands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Literal

from deltaq_experiments.model.ledger import Ledger
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
from deltaq_experiments.model.world import KEPT, SentSupervision, Turn, World
from deltaq_protocol.guarded import Admission, Command, CommandReply, GateMemory, Request, Supervision
from deltaq_protocol.messages import Message, Phase
from deltaq_services.sim.answers import Output
from deltaq_services.sim.core import Sim
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker

Act = Callable[[World], World]
_Kind = Literal["stop", "reset"]
_KINDS: tuple[_Kind, ...] = ("stop", "reset")


class GateSide:
    """The SIM, and all that can happen to what it is sent and sends."""

    def __init__(self) -> None:
        self._description = one_joint_cell()
        self._sim = self._new_sim()
        self._blank = self._sim.memory()

    def _new_sim(self) -> Sim:
        return one_joint_sim(self._description)

    def _sim_with(self, tracker_type: type[Tracker], orders_type: type[Orders]) -> Sim:
        """A SIM that follows its robot and orders it about with these."""
        sim = one_joint_sim(self._description)
        tracker = tracker_type(ROBOT, self._description.robots[ROBOT], CYCLE_S, LAG_CYCLES)
        sim.robots[ROBOT].tracker = tracker
        sim.robots[ROBOT].orders = orders_type(tracker, HLI_TIMEOUT_CYCLES)
        return sim

    # --- states on their way to the gate --------------------------------------------------------------------

    def states(self, world: World) -> Iterator[tuple[str, int, Act]]:
        """What can become of the state just published: moves, their faults, and what they do."""
        yield "the gate takes the state", 0, lambda w: self._take_states(w, -1)
        for kind in _KINDS:
            yield (
                f"{kind}, then the gate takes the state",
                0,
                partial(self._commanded_first, kind=kind),
            )
        yield "the state is late or lost", 1, self._take_states
        yield "the gate takes the state twice", 1, lambda w: self._take_states(w, -1, -1)
        if len(world.states) == KEPT:
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

    def hli(self, world: World) -> Iterator[tuple[str, int, Act]]:
        """What the HLI can send."""
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
                admissions, new_admission = (*admissions, output.message)[-KEPT:], True
            elif isinstance(output.message, Supervision):
                sent = SentSupervision(output.message, ledger.since_stop is not None)
                supervisions, new_supervision = (*supervisions, sent)[-KEPT:], True
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
