"""The gate's state of one robot: its motion, its orders, its tool, and the requests for it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_cell.description import GateDescription, RobotDescription, ToolChanger
from deltaq_protocol import topics
from deltaq_protocol.guarded import Command, CommandReply, CouplingMemory, RobotMemory, ServerState
from deltaq_protocol.messages import MOST_COUNTED_ON, Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.outputs import ToTopic
from deltaq_services.phases import MAY_MOVE
from deltaq_services.sim.compiled_certificate import CompiledCertifier
from deltaq_services.sim.gate import Contacts
from deltaq_services.sim.inbox import Inbox
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import drives_of


class CommandOrder:
    """The commands so far, so that none that was duplicated, overtaken or delayed is taken.

    Attributes:
        newest_id: the greatest id of a command so far.
    """

    def __init__(self) -> None:
        self.newest_id = 0

    def refusal(self, command: Command, epoch: int, robots: Iterable[GatedRobot]) -> CommandReply | None:
        """Why a command must not be taken, as the reply to it; None if it may.

        Args:
            command: any but a stop, which is obeyed whenever it comes.
            epoch: of this gate.
            robots: names of the robots that the command concerns.
        """
        if command.epoch != epoch:
            return self._refused(
                command, epoch, ReasonCode.STALE_EPOCH, f"gate epoch {command.epoch}, this is {epoch}"
            )
        if command.id >= MOST_COUNTED_ON:
            said = f"id {command.id}, it has to be less than {MOST_COUNTED_ON}"
            return self._refused(command, epoch, ReasonCode.MALFORMED, said)
        if command.id <= self.newest_id:
            said = f"id {command.id}, the newest so far is {self.newest_id}"
            return self._refused(command, epoch, ReasonCode.REPLAYED_SEQUENCE, said)
        for robot in robots:
            state, seen = robot.tracker.state, command.cycles.get(robot.name)
            if state is not None and (seen is None or state.cycle - seen > robot.max_age_cycles):
                said = f"refers to cycle {seen} of {robot.name}, which is at {state.cycle}"
                return self._refused(command, epoch, ReasonCode.STALE_CYCLE, said)
        return None

    def passed(self, command: Command) -> None:
        """Note that a command was taken or is out of date: earlier commands no longer count."""
        if command.id < MOST_COUNTED_ON:
            self.newest_id = max(self.newest_id, command.id)

    def _refused(self, command: Command, epoch: int, code: ReasonCode, message: str) -> CommandReply:
        return CommandReply(
            id=command.id,
            accepted=False,
            code=code,
            message=message,
            epoch=epoch,
            newest_id=self.newest_id,
        )


class Coupling:
    """What the gate knows of the tool at one robot's changer.

    It counts on a tool from the request until the input has confirmed its release. A tool in doubt keeps its bodies.

    Attributes:
        tool: the tool that is coupled; empty: none; None: not known.
        wanted: the tool that is being coupled, empty while one is released; None if none is being changed.
        present: the tools that may be there: the gate keeps the bodies of all of them clear.
    """

    def __init__(self, changer: ToolChanger, tools: Iterable[str], cycle_s: float) -> None:
        self.tool: str | None = None
        self.wanted: str | None = None
        self.tools = self.present = frozenset(tools)
        self.release = changer.release
        self._locked, self._within = changer.locked, math.ceil(changer.within_s / cycle_s)
        self._waited = 0
        self._heard = False

    @property
    def is_late(self) -> bool:
        """Whether the input should have confirmed the change by now."""
        return self._waited > self._within

    def observe(self, state: ServerState) -> bool:
        """Take the state of another cycle; returns whether the input agrees with the tool that the gate counts on."""
        locked = state.inputs.get(self._locked)
        if not self._heard:  # another gate's knowledge
            self._heard = True
            self._counts_on(state.tool if state.tool in {*self.tools, ""} else None)
        if self.wanted is not None:
            if locked is not bool(self.wanted):
                self._waited += 1
                return not self.is_late
            self._counts_on(self.wanted)
        elif (self.tool is None and locked is False) or (self.tool == "" and locked):
            was_known = self.tool is not None
            self._counts_on(None if was_known else "")
            return not was_known
        return self.tool is None or locked is bool(self.tool)

    def want(self, tool: str) -> None:
        """A change was requested: the input has to confirm it."""
        self.wanted, self._waited = tool, 0
        self.present |= {tool} - {""}

    def problem(self, inputs: Mapping[str, bool]) -> str:
        """Why the robot must not move, in words, from its inputs; empty if it may."""
        if self.wanted is not None:
            asked = f"{self.wanted} is locked" if self.wanted else "the tool is released"
            return f"input {self._locked} has not confirmed that {asked}"
        if self.tool is None:
            return "the tool at its changer is not known: couple it again, or release it"
        if self.tool and not inputs.get(self._locked):
            return f"input {self._locked} is off, {self.tool} should be locked: lock it, or release it"
        return ""

    def _counts_on(self, tool: str | None) -> None:
        self.tool, self.wanted, self._waited = tool, None, 0
        self.present = self.tools if tool is None else frozenset({tool} - {""})

    def snapshot(self) -> CouplingMemory:
        """Snapshot for `restore`."""
        present = tuple(sorted(self.present))
        return CouplingMemory(
            tool=self.tool, wanted=self.wanted, present=present, waited=self._waited, heard=self._heard
        )

    def restore(self, memory: CouplingMemory) -> None:
        """Restore another gate's snapshot."""
        self.tool, self.wanted, self.present = memory.tool, memory.wanted, frozenset(memory.present)
        self._waited, self._heard = memory.waited, memory.heard


_GAP = 4
"""Times that a Robot Server may be without a gate before it holds: orders that are under way arrive later."""


class GatedRobot:
    """The gate's data of one robot.

    Attributes:
        name: of the robot.
        joints: how many it has.
        max_age_cycles: a command that refers to an older state is stale.
        tracker: its motion.
        orders: stop, reset and outputs.
        inbox: the requests for it.
        longest_gap_cycles: cycles that may be missed while it may move; a Robot Server without a gate holds it
            before.
        dry_run_cycle: cycle of the state for which a dry run was answered last.
        coupling: the tool at its changer; None if it has none.
    """

    def __init__(
        self, name: str, description: RobotDescription, gate: GateDescription, cycle_s: float
    ) -> None:
        self.name = name
        self.joints = len(description.joints)
        self.max_age_cycles = topics.COMMAND.age_cycles(cycle_s, gate.max_request_age_s)
        self.tracker = Tracker(
            name, description, drives_of(description, gate, cycle_s), cycle_s, gate.lookahead_cycles
        )
        self.orders = Orders(self.tracker, math.ceil(gate.hli_timeout_s / cycle_s))
        self.inbox = Inbox(
            self.joints, topics.REQUEST.age_cycles(cycle_s, gate.max_request_age_s), gate.lookahead_cycles
        )
        self.longest_gap_cycles = _GAP * math.ceil(gate.gate_timeout_s / cycle_s)
        self.dry_run_cycle = -1
        changer = description.tool_changer
        self.coupling = None if changer is None else Coupling(changer, description.tools, cycle_s)

    @property
    def parts(self) -> tuple[object, ...]:
        """The objects that change."""
        coupling = () if self.coupling is None else (self.coupling,)
        return self, self.tracker, self.tracker.history, self.orders, self.inbox, *coupling

    def snapshot(self) -> RobotMemory:
        """Snapshot for `restore`."""
        return RobotMemory(
            tracker=self.tracker.snapshot(),
            orders=self.orders.snapshot(),
            waiting=self.inbox.waiting,
            decided=self.inbox.decided,
            decided_cycle=self.inbox.decided_cycle,
            spoken_cycle=self.inbox.spoken_cycle,
            lease_epoch=self.inbox.lease_epoch,
            seq=self.inbox.seq,
            dry_run_cycle=self.dry_run_cycle,
            coupling=None if self.coupling is None else self.coupling.snapshot(),
        )

    def restore(self, memory: RobotMemory) -> None:
        """Restore another gate's snapshot of this robot."""
        self.tracker.restore(memory.tracker)
        self.orders.restore(memory.orders)
        self.inbox.waiting, self.inbox.decided = memory.waiting, memory.decided
        self.inbox.decided_cycle, self.inbox.spoken_cycle = memory.decided_cycle, memory.spoken_cycle
        self.inbox.lease_epoch, self.inbox.seq = memory.lease_epoch, memory.seq
        self.dry_run_cycle = memory.dry_run_cycle
        if self.coupling is not None and memory.coupling is not None:
            self.coupling.restore(memory.coupling)


class Couplings:
    """The tools of all robots: what may be there is kept clear of everything else.

    Args:
        robots: by name.
        bodies: names of the bodies of each tool, by robot.
        proximity: measures them.
        contacts: leaves out the pairs of tools that are not there.
    """

    def __init__(
        self,
        robots: Mapping[str, GatedRobot],
        bodies: Mapping[str, Mapping[str, frozenset[str]]],
        proximity: CompiledProximity,
        contacts: Contacts,
    ) -> None:
        self._robots, self._bodies = robots, bodies
        self._proximity, self._contacts = proximity, contacts

    def watch(self, robot: GatedRobot, state: ServerState) -> None:
        """Follow the tool at a changer, and hold a robot whose input does not confirm it."""
        coupling = robot.coupling
        assert coupling is not None  # only asked of robots with a changer
        before = coupling.present
        if not coupling.observe(state) and state.phase in MAY_MOVE:
            robot.orders.stop(ReasonCode.TOOL_MISMATCH)
        if coupling.present != before:
            self.keep_clear()

    def keep_clear(self) -> None:
        """Measure the bodies of those tools that may be there, and of no other."""
        absent = [
            self._bodies[name][tool]
            for name, robot in self._robots.items()
            if robot.coupling is not None
            for tool in robot.coupling.tools - robot.coupling.present
        ]
        self._contacts.without(frozenset().union(*absent))

    def change(self, robot: GatedRobot, tool: str) -> tuple[ReasonCode, str] | None:
        """Switch a tool changer, to couple a tool or to release one; returns why not if it is refused."""
        coupling, state = robot.coupling, robot.tracker.state
        if coupling is None or tool not in {*coupling.tools, ""}:
            has = ", ".join(sorted(coupling.tools)) if coupling else "no tool changer"
            return ReasonCode.MALFORMED, f"no tool {tool!r}; {robot.name} has {has}"
        if state is None or state.phase is Phase.OFFLINE:
            return ReasonCode.NOT_READY, f"{robot.name} is offline"
        if not robot.tracker.at_rest() or any(any(each.dq) for each in robot.tracker.in_flight):
            return ReasonCode.NOT_AT_REST, f"{robot.name} moves"
        if coupling.wanted is not None and not coupling.is_late:
            return ReasonCode.NOT_READY, coupling.problem(state.inputs)
        if tool and coupling.tool not in (None, "", tool):
            return ReasonCode.NOT_READY, f"{coupling.tool} is coupled; release it first"
        if tool and coupling.tool == "" and not coupling.is_late and not state.outputs.get(coupling.release):
            return ReasonCode.NOT_READY, f"the tool changer of {robot.name} is closed: release it first"
        too_near = self._too_near(robot, tool) if tool and tool not in coupling.present else None
        if too_near is None:
            coupling.want(tool)
            robot.orders.outputs[coupling.release] = not tool
        self.keep_clear()
        return too_near

    def _too_near(self, robot: GatedRobot, tool: str) -> tuple[ReasonCode, str] | None:
        """Why a tool that is not there yet would be nearer to other bodies than is allowed; None if it would not."""
        others = [other.tracker for other in self._robots.values() if other is not robot]
        if unknown := [other.name for other in others if not other.is_known]:
            return ReasonCode.NOT_READY, f"the gate does not know where {unknown[0]} is"
        self._contacts.without(self._contacts.absent - self._bodies[robot.name][tool])
        tubes = [(other.name, tube) for other in others for tube in other.tubes()]
        standing = robot.tracker.standing()
        certificate = CompiledCertifier(self._proximity).certify(robot.name, standing, tubes)
        if certificate.holds:
            return None
        binding = certificate.binding
        assert binding is not None  # a failed certificate names its pair
        return ReasonCode.CLEARANCE, (
            f"{' and '.join(binding.nearest.pair)} would be {binding.nearest.swept_m:.4f} m apart, at least "
            f"{binding.stop_distance_m:.4f} m is required"
        )


def doubt(robot: GatedRobot) -> tuple[ReasonCode, str] | None:
    """The message about a tool that is not known or not confirmed; None if there is no doubt, or no state."""
    if robot.coupling is None or robot.tracker.state is None:
        return None
    text = robot.coupling.problem(robot.tracker.state.inputs)
    return (ReasonCode.CAUSE_STANDS, text) if text else None


def reply(id_: int, code: ReasonCode | None = None, message: str = "") -> ToTopic:
    """The reply to a command: taken or, with a code, why not."""
    answer = CommandReply(id=id_, accepted=code is None, code=code, message=message)
    return ToTopic(topics.COMMAND_REPLY, "", answer)
