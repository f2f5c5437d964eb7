"""What can happen between Robot Server and gate, at the gate, and between HLI and gate.

The gate is the SIM's own code. Each wire may lose, keep back, double and reorder; the HLI is anybody who may send
requests and commands.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Literal

from deltaq_proofs.model_checker.one_joint import (
    CYCLE_S,
    FASTEST,
    HLI_TIMEOUT_CYCLES,
    LEASE,
    ROBOT,
    STEP,
    one_joint_cell,
    one_joint_sim,
)
from deltaq_proofs.model_checker.safety_monitor import SafetyMonitor
from deltaq_proofs.model_checker.system_state import KEPT, SentSupervision, SystemState, Turn
from deltaq_protocol.guarded import Admission, Command, CommandReply, GateMemory, Request, Supervision
from deltaq_protocol.messages import Message, Phase
from deltaq_services.outputs import ToTopic
from deltaq_services.sim.core import Sim
from deltaq_services.sim.inbox import Inbox
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import drives_of

Act = Callable[[SystemState], SystemState]
_Kind = Literal["stop", "reset"]
_KINDS: tuple[_Kind, ...] = ("stop", "reset")


class GateSide:
    """The SIM, and all that can happen to what it is sent and sends."""

    def __init__(self, lookahead_cycles: int = 1) -> None:
        self._description = one_joint_cell(lookahead_cycles=lookahead_cycles)
        self._kept_admissions = KEPT - 1 + lookahead_cycles
        self._sim = self._new_sim()
        self._blank = self._sim.snapshot()

    def _new_sim(self) -> Sim:
        return one_joint_sim(self._description)

    def _sim_with(
        self, tracker_type: type[Tracker], orders_type: type[Orders], inbox_type: type[Inbox] = Inbox
    ) -> Sim:
        """A SIM that follows its robot, orders it about and keeps requests with these."""
        sim = one_joint_sim(self._description)
        ahead = self._description.gate.lookahead_cycles
        robot = self._description.robots[ROBOT]
        drives = drives_of(robot, self._description.gate, CYCLE_S)
        tracker = tracker_type(ROBOT, robot, drives, CYCLE_S, ahead)
        sim.robots[ROBOT].tracker = tracker
        sim.robots[ROBOT].orders = orders_type(tracker, HLI_TIMEOUT_CYCLES)
        sim.robots[ROBOT].inbox = inbox_type(joints=1, max_age_cycles=1)
        return sim

    # --- states on their way to the gate --------------------------------------------------------------------

    def states(self, system_state: SystemState) -> Iterator[tuple[str, int, Act]]:
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
        if len(system_state.states) == KEPT:
            yield "the gate takes the state before again", 1, lambda w: self._take_states(w, -2)
            yield "the gate takes both states, the newer first", 1, lambda w: self._take_states(w, -1, -2)
            yield "the gate takes the state before, then the newer", 1, lambda w: self._take_states(w, -2, -1)
        yield "the gate crashes and starts anew", 1, self._gate_crash

    def _take_states(self, system_state: SystemState, *which: int) -> SystemState:
        for index in which:
            sent = system_state.states[index]
            known = system_state.gate.robots[ROBOT].tracker.state
            if known is None or sent.message.time_s >= known.time_s:
                # silence shows by a state that repeats a cycle; the first of a cycle may be the only one that came
                repeats = known is not None and sent.message.cycle == known.cycle
                system_state = replace(
                    system_state, monitor=replace(system_state.monitor, silence_told=sent.silent and repeats)
                )
            system_state = self._gate_takes(system_state, sent.message)
        return replace(system_state, turn=Turn.HLI)

    def _gate_crash(self, system_state: SystemState) -> SystemState:
        blank = self._blank.model_copy(update={"epoch": system_state.gate.epoch + 1})
        assert system_state.server.state is not None  # it has just published one
        offline = system_state.server.state.phase is Phase.OFFLINE
        return replace(
            system_state, gate=blank, turn=Turn.HLI, monitor=system_state.monitor.gate_crashed(offline)
        )

    # --- the HLI ----------------------------------------------------------------------------------------------

    def hli(self, system_state: SystemState) -> Iterator[tuple[str, int, Act]]:
        """What the HLI can send."""
        yield "the HLI says nothing", 0, lambda w: replace(w, turn=Turn.TELEGRAM)
        state = system_state.gate.robots[ROBOT].tracker.state
        cycle = state.cycle if state is not None else 0
        yield (
            "the HLI gives a heartbeat",
            0,
            lambda w: self._asks(w, Request(robot=ROBOT, cycle=cycle, lease_epoch=LEASE)),
        )
        yield (
            "the HLI says that the lease has ended",
            0,
            lambda w: self._asks(w, Request(robot=ROBOT, cycle=cycle, lease_epoch=0)),
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
            yield (
                "request that waited for a state which it overtakes",
                1,
                lambda w: self._asks(w, _request(w, cycle, min(FASTEST, now + 1), newest=cycle + 1)),
            )
        for kind in _KINDS:
            yield kind, 0, partial(self._commanded_after, kind=kind)

    def _asks(self, system_state: SystemState, request: Request) -> SystemState:
        return replace(self._gate_takes(system_state, request), turn=Turn.TELEGRAM)

    def _requested(self, system_state: SystemState, cycle: int, steps: int) -> SystemState:
        return self._asks(system_state, _request(system_state, cycle, steps))

    def _commanded_after(self, system_state: SystemState, kind: _Kind) -> SystemState:
        return replace(self._command(system_state, kind), turn=Turn.TELEGRAM)

    def _commanded_first(self, system_state: SystemState, kind: _Kind) -> SystemState:
        return self._take_states(self._command(system_state, kind), -1)

    def _command(self, system_state: SystemState, kind: _Kind) -> SystemState:
        state = system_state.gate.robots[ROBOT].tracker.state
        command = Command(
            id=system_state.gate.command_id + 1,
            kind=kind,
            epoch=system_state.gate.epoch,
            cycles={} if state is None else {ROBOT: state.cycle},
            robot=ROBOT,
        )
        return self._gate_takes(system_state, command)

    # --- the gate ---------------------------------------------------------------------------------------------

    def _gate_takes(self, system_state: SystemState, message: Message) -> SystemState:
        self._sim.restore(system_state.gate)
        outputs = self._sim.take(message)
        monitor, admissions, supervisions = (
            system_state.monitor,
            system_state.admissions,
            system_state.supervisions,
        )
        new_admission, new_supervision = system_state.new_admission, system_state.new_supervision
        if isinstance(message, Command):
            monitor = _commanded(monitor, message, outputs, system_state.gate)
            if monitor.since_stop is None:
                supervisions = tuple(replace(sent, order_of_stop=False) for sent in supervisions)
        answers = [output.message for output in outputs]
        used = system_state.used.gate_took(message, answers, system_state.gate.epoch, system_state.gate)
        for output in outputs:
            if isinstance(output.message, Admission):
                admissions, new_admission = (*admissions, output.message)[-self._kept_admissions :], True
            elif isinstance(output.message, Supervision):
                sent = SentSupervision(output.message, monitor.since_stop is not None)
                supervisions, new_supervision = (*supervisions, sent)[-KEPT:], True
        return replace(
            system_state,
            gate=self._sim.snapshot(),
            monitor=monitor,
            admissions=admissions,
            supervisions=supervisions,
            new_admission=new_admission,
            new_supervision=new_supervision,
            used=used,
        )


def _commanded(
    monitor: SafetyMonitor, command: Command, outputs: list[ToTopic], gate: GateMemory
) -> SafetyMonitor:
    if command.kind == "stop":
        return monitor.stop_taken()
    refused = any(isinstance(o.message, CommandReply) and not o.message.accepted for o in outputs)
    believed = gate.robots[ROBOT].tracker.state
    return monitor if refused or believed is None else monitor.reset_accepted(believed)


def _request(system_state: SystemState, cycle: int, steps: int, newest: int | None = None) -> Request:
    seq = system_state.gate.robots[ROBOT].seq + 1
    return Request(robot=ROBOT, cycle=cycle, newest=newest, lease_epoch=LEASE, seq=seq, dq=(steps * STEP,))
