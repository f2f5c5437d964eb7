"""The SIM's decisions: states, requests and commands in; admissions, supervision, verdicts and replies out.

Pure: no clock, no I/O. Time is counted in cycles of the robots. Each robot is decided at most once for
each of its states, one request after the other, so that a decision always sees what the last one admitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain, combinations
from typing import Protocol

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.identity import content_identity
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import (
    Admission,
    Command,
    CommandReply,
    GateMemory,
    Request,
    ServerState,
    Supervision,
)
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.messages import Message, NearestPair, Outcome, Reason, Verdict
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.receipts import first_receipt, with_receipt
from deltaq_protocol.topic import Messages
from deltaq_services.containment import Containment
from deltaq_services.outputs import ToTopic
from deltaq_services.phases import MAY_MOVE
from deltaq_services.sim.causes import impossible
from deltaq_services.sim.fingerprint import fingerprint
from deltaq_services.sim.gate import Contacts, Decision, Gate, nearest_pair, verdict_of
from deltaq_services.sim.gated_robot import CommandOrder, Couplings, GatedRobot, doubt, reply
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.retreat import Violations
from deltaq_services.sim.tracker import Tracker


class Decider(Protocol):
    """Decides a request: the gate, or a stopwatch around it."""

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        """Decide one request."""
        ...


class Sim:
    """The SIM without its process.

    Attributes:
        gate: makes the decisions.
        robots: its state of each robot.
        counters: outcomes and reasons so far.
        fingerprint: of the gate's code and configuration.
        contacts: the contacts that are allowed now.
        violations: the pairs that are too near now, and the distances that they have to keep.
        taken: messages taken so far.
        disbelieved: the last rejected state of a robot, in words; empty if there was none.
        containment: of unexpected errors.
    """

    def __init__(self, cell: CellModel, epoch: int) -> None:
        description = cell.description
        cycle_s = self._cycle_s = description.cycle_s
        self.epoch = epoch
        self.fingerprint = fingerprint(cell)
        # of the description alone: a Robot Server reads no bodies
        self._cell = str(content_identity(description))
        self.taken = 0
        self.disbelieved = ""
        self._receipt = first_receipt(self.fingerprint, epoch)
        self.counters: Counter[str] = Counter()
        self._proximity = CompiledProximity(cell)
        self.robots = {
            name: GatedRobot(name, robot, description.gate, cycle_s)
            for name, robot in description.robots.items()
        }
        bodies = {name: robot.tool_bodies for name, robot in cell.robots.items()}
        named = frozenset().union(*(each for tools in bodies.values() for each in tools.values()))
        self.contacts = Contacts(self._proximity, description.contacts, named)
        self._couplings = Couplings(self.robots, bodies, self._proximity, self.contacts)
        self.violations = Violations()
        self.gate: Decider = Gate(
            self._proximity,
            {name: Limits.of(robot, cycle_s) for name, robot in description.robots.items()},
            description.gate,
            self.contacts,
            self.violations,
        )
        self._sequence = 0
        self._command_order = CommandOrder()
        shared = (self, self.contacts, self.violations, self._command_order)
        # a message about one robot changes no other, but that an impossible state stops all: they stay stopped
        self._parts = {name: (*shared, *robot.parts) for name, robot in self.robots.items()}
        self._every_part = tuple(chain(shared, *(robot.parts for robot in self.robots.values())))
        self.containment = Containment()

    def take(self, message: Message) -> list[ToTopic]:
        """Take a state, a request or a command; their order determines every decision.

        A message that causes an unexpected error counts as lost, and the robot that it concerns is held.

        Raises:
            TypeError: for a message of a type that is not sent here.
        """
        if not isinstance(message, ServerState | Request | Command):
            raise TypeError(f"the gate takes states, requests and commands, got a {type(message).__name__}")
        self.containment.remember(self._parts.get(message.robot or "", self._every_part))
        try:
            if isinstance(message, ServerState):
                return self.on_state(message)
            if isinstance(message, Request):
                return self.on_request(message)
            return self.on_command(message)
        except Exception as error:  # none may end the gate, and with it every robot's motion
            self.containment.put_back()
            self.containment.note(error)
            return self._failed(message)

    def _failed(self, message: ServerState | Request | Command) -> list[ToTopic]:
        """Refuse a message that made no difference, and hold the robot that it concerns."""
        self.taken += 1
        self.counters["internal_errors"] += 1
        self._proximity.forget()
        self.contacts.allow(self.contacts.allowed)
        outputs = []
        refused = [message] if isinstance(message, Request) and message.dq is not None else []
        for robot in self.concerned(message):
            robot.orders.stop(ReasonCode.INTERNAL_ERROR)
            waiting = robot.inbox.forget()  # it may have caused the error, and would again
            refused += [] if waiting is None else [waiting]
            if isinstance(message, ServerState) and robot.tracker.state is not None:
                outputs.append(self._order(robot, message.cycle))
        if isinstance(message, Command):
            self._command_order.passed(message)
            text = EXPLANATIONS[ReasonCode.INTERNAL_ERROR]
            outputs.append(reply(message.id, ReasonCode.INTERNAL_ERROR, text))
        return outputs + [self._refuse(each, Reason(code=ReasonCode.INTERNAL_ERROR)) for each in refused]

    def hold_all(self) -> None:
        """Order all robots to stop: the code that sends the orders has failed."""
        self.counters["internal_errors"] += 1
        for robot in self.robots.values():
            robot.orders.stop(ReasonCode.INTERNAL_ERROR)

    def concerned(self, message: ServerState | Request | Command) -> list[GatedRobot]:
        """The robots that a message concerns: all, if it names none."""
        return [robot for name, robot in self.robots.items() if message.robot in (None, name)]

    def on_state(self, state: ServerState) -> list[ToTopic]:
        """A Robot Server published its state."""
        self.taken += 1
        robot = self.robots.get(state.robot)
        if robot is None or len(state.q) != robot.joints:
            self.counters["unknown_state"] += 1
            return []
        if self._is_impossible(robot, state):
            return self._supervise(robot, ReasonCode.IMPOSSIBLE_STATE)
        missed_before = robot.tracker.missed
        if not robot.tracker.observe(state):
            robot.orders.repeated(state)
            return [*self._supervise(robot), *self._answered(robot)]
        missed = robot.tracker.missed
        self.counters[f"missed_admissions_{robot.name}"] = missed
        robot.orders.cycle_passed()
        if robot.tracker.restarted:
            robot.orders.server_restarted(state)
            robot.inbox.begin_anew()
        if robot.tracker.restarted or robot.tracker.displaced:
            self.violations.only(robot.name, ())  # they were measured where it stood before
        if robot.coupling is not None:
            self._couplings.watch(robot, state)
        outdated = robot.inbox.cycle_passed(state.cycle, missed > missed_before)
        refused = [] if outdated is None else [self._refuse(outdated, _out_of_date(outdated, state))]
        if robot.inbox.waiting is not None:
            self.counters[f"in_hand_{robot.name}"] += 1
        return [*self._supervise(robot), *self._answered(robot), *refused, *self._decide(robot)]

    def on_request(self, request: Request) -> list[ToTopic]:
        """The HLI sent an increment, or a heartbeat."""
        self.taken += 1
        robot = self.robots.get(request.robot)
        if robot is None:
            self.counters["unknown_request"] += 1
            return []
        robot.orders.hli_heard()
        newest_cycle = -1 if robot.tracker.state is None else robot.tracker.state.cycle
        if request.dq is None:
            ended = robot.inbox.heartbeat(request, newest_cycle)
            if ended is not None:
                return [self._refuse(ended, Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease"))]
            return self._decide(robot)
        reason = robot.inbox.fault(request)
        if reason is not None:
            return [self._refuse(request, reason)]
        replaced = robot.inbox.put(request, newest_cycle)
        outputs = [] if replaced is None else [self._refuse(replaced, Reason(code=ReasonCode.SUPERSEDED))]
        return outputs + self._decide(robot)

    def on_command(self, command: Command) -> list[ToTopic]:
        """The HLI passed on a stop, a reset, digital outputs, a dry run, or a change of contacts or of a tool."""
        self.taken += 1
        robots = self.concerned(command)
        if not robots:
            return [reply(command.id, ReasonCode.UNKNOWN_ROBOT, f"no robot {command.robot!r} here")]
        if command.kind != "stop":
            refusal = self._command_order.refusal(command, self.epoch, robots)
            if refusal is not None:
                self.counters[f"command_{refusal.code}"] += 1
                return [ToTopic(topics.COMMAND_REPLY, "", refusal)]
        self._command_order.passed(command)
        self.counters[f"command_{command.kind}"] += 1
        if command.kind == "dry_run":
            return [self._dry_run(command)]
        if command.kind == "contact":
            return [self._switch_contact(command)]
        if command.kind == "reset":
            return self._reset(command, robots)
        if command.kind == "stop":
            return self._stop(command, robots)
        if command.kind == "tool" and len(robots) == 1:
            return [reply(command.id, *(self._couplings.change(robots[0], command.tool) or ()))]
        switches = any(robot.coupling and robot.coupling.release in command.outputs for robot in robots)
        if switches or command.kind == "tool":
            text = "a tool changer is switched by a request for a tool of one robot"
            return [reply(command.id, ReasonCode.NOT_PERMITTED, text)]
        for robot in robots:
            robot.orders.outputs.update(command.outputs)
        return [reply(command.id)]

    def _stop(self, command: Command, robots: Sequence[GatedRobot]) -> list[ToTopic]:
        """Order a stop at once, and answer when the last robot shows it."""
        outputs = []
        for robot in robots:
            robot.orders.answer_when_stopped(command.id)
            robot.orders.stop(command.reason)
            outputs += self._forget(robot)
        if not any(robot.orders.awaits_stop(command.id) for robot in robots):
            outputs.append(reply(command.id))
        return outputs

    def _reset(self, command: Command, robots: Sequence[GatedRobot]) -> list[ToTopic]:
        """Order a reset, drop earlier requests, and answer when each robot shows the reset."""
        outputs = []
        for robot in robots:
            refused = self._other_cell(robot) or doubt(robot) or robot.orders.reset(command.id)
            outputs += self._forget(robot) if refused is None else [reply(command.id, *refused)]
        return outputs

    def _forget(self, robot: GatedRobot) -> list[ToTopic]:
        waiting = robot.inbox.forget()
        return [] if waiting is None else [self._refuse(waiting, Reason(code=ReasonCode.STOPPED))]

    def _switch_contact(self, command: Command) -> ToTopic:
        if command.contact not in self.contacts:
            return reply(command.id, ReasonCode.MALFORMED, f"no contact {command.contact!r} here")
        self.contacts.switch(command.contact or "", command.allowed)
        return reply(command.id)

    def _dry_run(self, command: Command) -> ToTopic:
        """Decide on an increment without admitting it.

        At most one for each state, so that no client keeps the gate busy.
        """
        robot = self.robots.get(command.robot or "")
        state = None if robot is None else robot.tracker.state
        if robot is None or state is None:
            return reply(command.id, ReasonCode.NOT_READY, "no state of that robot yet")
        dq = command.dq or ()
        if len(dq) != robot.joints:
            return reply(command.id, ReasonCode.BAD_SHAPE, f"dq has {len(dq)} elements, not {robot.joints}")
        if robot.dry_run_cycle == state.cycle:
            return reply(command.id, ReasonCode.SUPERSEDED, "one dry run for each state of the robot")
        robot.dry_run_cycle = state.cycle
        if state.phase not in MAY_MOVE or robot.orders.standing_stop is not None:
            return reply(command.id, ReasonCode.STOPPED, f"{robot.name} is {state.phase}")
        reason = self._unready(state)
        if reason is not None:
            return reply(command.id, reason.code, f"{robot.name}: {reason.what}")
        robot.tracker.decide_after(None)
        decision = self._judge(robot, dq)
        verdict = verdict_of(
            robot.name, state.cycle, robot.tracker.decided_after + 1, 0, decision, self._cycle_s
        )
        answer = CommandReply(id=command.id, accepted=True, verdict=verdict)
        return ToTopic(topics.COMMAND_REPLY, "", answer)

    @property
    def newest_id(self) -> int:
        """The greatest id of a command so far."""
        return self._command_order.newest_id

    @property
    def memory_is_due(self) -> bool:
        """Whether a snapshot follows the newest message; replays begin, or continue after a gap, at snapshots.

        One follows each message that was refused after an error: a replay that meets no such error tells the
        difference, and goes on from there.
        """
        rate = topics.GATE_MEMORY.rate
        assert isinstance(rate, Messages)  # that is how the table counts them
        return self.containment.failed or self.taken % rate.messages == 0

    def snapshot(self) -> GateMemory:
        """Snapshot of all that decisions depend on, for `restore`."""
        return GateMemory(
            epoch=self.epoch,
            number=self.taken,
            sequence=self._sequence,
            command_id=self._command_order.newest_id,
            receipt=self._receipt,
            fingerprint=self.fingerprint,
            contacts=self.contacts.allowed,
            violations=self.violations.snapshot(),
            robots={name: robot.snapshot() for name, robot in self.robots.items()},
            cell=self._cell,
        )

    def restore(self, memory: GateMemory) -> None:
        """Restore the state of another gate of this cell, except its counters."""
        self.epoch, self.taken, self._cell = memory.epoch, memory.number, memory.cell
        self._sequence, self._receipt = memory.sequence, memory.receipt
        self._command_order.newest_id = memory.command_id
        self.contacts.allow(memory.contacts)
        self.violations.restore(memory.violations)
        for name, robot in memory.robots.items():
            self.robots[name].restore(robot)
        self._couplings.keep_clear()

    def nearest(self) -> NearestPair | None:
        """The nearest two bodies of different robots, or of a robot and the structure or itself, now."""
        known = [robot.tracker for robot in self.robots.values() if robot.tracker.state is not None]
        return self.nearest_at({robot.name: robot.q_cmd for robot in known})

    def nearest_at(self, q: Mapping[str, Array]) -> NearestPair | None:
        """The same with some robots at `q`, each (n,) [rad or m]."""
        for name, at in q.items():
            self._proximity.place(name, at, np.zeros_like(at))
        lists = [self._proximity.alone[name] for name in q]
        lists += [self._proximity.between[one, other] for one, other in combinations(q, 2)]
        looks = [self._proximity.look(groups, 0.0).tightest for groups in lists if groups]
        found = [near for near in looks if near is not None]
        return nearest_pair(min(found, key=lambda near: near.distance_m)) if found else None

    def _is_impossible(self, robot: GatedRobot, state: ServerState) -> bool:
        """Whether this gate cannot have caused a state: counted, and all robots are stopped, wherever they are."""
        fault = impossible(
            state,
            robot.tracker.state,
            robot.tracker.in_flight,
            self.epoch,
            robot.orders.resets,
            robot.longest_gap_cycles,
        )
        if fault is None:
            return False
        self.counters[f"impossible_states_{robot.name}"] += 1
        self.disbelieved = f"{robot.name} told {fault}"
        for each in self.robots.values():
            each.orders.stop(ReasonCode.IMPOSSIBLE_STATE)
        return True

    def _supervise(self, robot: GatedRobot, stop: ReasonCode | None = None) -> list[ToTopic]:
        """Orders to a robot with a state; `stop` is sent whatever its newest state shows."""
        robot.orders.judge()
        if stop is not None:
            robot.orders.stop(stop)
        state = robot.tracker.state
        assert state is not None  # called with a state just observed
        if state.cell != self._cell:
            self.counters[f"states_of_another_cell_{robot.name}"] += 1
            robot.orders.stop(ReasonCode.CELL_MISMATCH)
        return [self._order(robot, state.cycle)]

    def _order(self, robot: GatedRobot, cycle: int) -> ToTopic:
        """The standing orders to a robot, in a cycle of it."""
        message = Supervision(
            robot=robot.name,
            epoch=self.epoch,
            cycle=cycle,
            stop=robot.orders.standing_stop,
            resets=robot.orders.resets,
            outputs=robot.orders.outputs,
            cell=self._cell,
            tool=robot.coupling and robot.coupling.tool,
        )
        return ToTopic(topics.SUPERVISION, robot.name, message)

    def _answered(self, robot: GatedRobot) -> list[ToTopic]:
        stops = [
            id_
            for id_ in robot.orders.latched()
            if not any(other.orders.awaits_stop(id_) for other in self.robots.values())
        ]
        return [reply(id_) for id_ in (*robot.orders.fulfilled(), *stops)]

    def _decide(self, robot: GatedRobot) -> list[ToTopic]:
        inbox, state = robot.inbox, robot.tracker.state
        if state is None or not inbox.due(state):
            return []
        reason = inbox.fault_on(state, robot.orders.standing_stop is not None)
        reason = reason or self._unready(state)
        goes_after = inbox.goes_after(state)
        request = inbox.take()
        assert request is not None  # it is due
        assert request.dq is not None  # heartbeats are not put there
        if reason is not None:
            return [self._refuse(request, reason)]
        inbox.decided_cycle = goes_after
        robot.tracker.decide_after(goes_after)
        decision = self._judge(robot, request.dq)
        outputs = [self._verdict(request, state.cycle, goes_after + 1, decision)]
        if decision.outcome is not Outcome.HELD:
            inbox.decided = request
            outputs.insert(0, self._admit(robot, state, decision))
        return outputs

    def _judge(self, robot: GatedRobot, dq: Sequence[float]) -> Decision:
        others = [other.tracker for other in self.robots.values() if other is not robot]
        return self.gate.decide(robot.tracker, others, np.array(dq))

    def _unready(self, state: ServerState) -> Reason | None:
        """Why no request can be decided on a state; None if one can."""
        unheard = [name for name, other in self.robots.items() if other.tracker.state is None]
        unknown = [name for name, other in self.robots.items() if not other.tracker.is_known]
        if unknown:  # its position or its last motion is unknown, so nothing can be kept clear of it
            return Reason(code=ReasonCode.NOT_READY, what=(unheard or unknown)[0])
        others = [told[1] for other in self.robots.values() if (told := self._other_cell(other)) is not None]
        if others:  # its limits and bodies may be others than those that are decided by
            return Reason(code=ReasonCode.CELL_MISMATCH, what=others[0])
        if state.epoch != self.epoch:
            return Reason(code=ReasonCode.NOT_READY, what="gate epoch")
        if in_doubt := doubt(self.robots[state.robot]):
            return Reason(code=ReasonCode.TOOL_MISMATCH, what=in_doubt[1])
        return None

    def _other_cell(self, robot: GatedRobot) -> tuple[ReasonCode, str] | None:
        """The message about a Robot Server that has read another cell; None if it has not, or is silent."""
        state = robot.tracker.state
        if state is None or state.cell == self._cell:
            return None
        theirs, ours = CellIdentity.parse(state.cell), CellIdentity.parse(self._cell)
        return ReasonCode.CELL_MISMATCH, mismatch(f"the Robot Server of {robot.name}", theirs, ours)

    def _admit(self, robot: GatedRobot, state: ServerState, decision: Decision) -> ToTopic:
        self._sequence += 1
        ahead = robot.tracker.ahead
        admission = Admission(
            robot=robot.name,
            epoch=self.epoch,
            sequence=self._sequence,
            cycle=robot.tracker.decided_after,
            follows_sequence=ahead.sequence,
            follows_q_cmd=tuple(ahead.q_cmd.tolist()),
            follows_dq=tuple(ahead.dq.tolist()),
            follows_resets=state.resets,
            dq=tuple(decision.dq.tolist()),
            brake_cycles=decision.brake_cycles,
        )
        robot.tracker.admitted(admission)
        return ToTopic(topics.ADMISSION, robot.name, admission)

    def _verdict(self, request: Request, cycle: int, setpoint_cycle: int, decision: Decision) -> ToTopic:
        self.counters[decision.outcome] += 1
        for reason in decision.reasons[:1]:
            self.counters[f"reason_{reason.code}"] += 1
        verdict = verdict_of(request.robot, cycle, setpoint_cycle, request.seq, decision, self._cycle_s)
        if decision.outcome is Outcome.HELD:
            verdict = self._with_receipt(verdict)
        return ToTopic(topics.GATE_VERDICT, request.robot, verdict)

    def _refuse(self, request: Request, reason: Reason) -> ToTopic:
        self.counters[Outcome.REFUSED] += 1
        self.counters[f"reason_{reason.code}"] += 1
        verdict = Verdict(
            robot=request.robot,
            cycle=request.cycle,
            seq=request.seq,
            outcome=Outcome.REFUSED,
            reasons=(reason,),
        )
        return ToTopic(topics.GATE_VERDICT, request.robot, self._with_receipt(verdict))

    def _with_receipt(self, verdict: Verdict) -> Verdict:
        signed = with_receipt(self._receipt, verdict)
        assert signed.receipt is not None  # that is what it was given
        self._receipt = signed.receipt
        return signed


def _out_of_date(request: Request, state: ServerState) -> Reason:
    """Why a request that waited is out of date."""
    return Reason(code=ReasonCode.STALE_CYCLE, what="cycle", value=request.cycle, bound=state.cycle - 1)
