"""The gate's state of one robot: its motion, its orders, and the requests for it."""

from __future__ import annotations

import math
from collections.abc import Iterable

from deltaq_cell.description import GateDescription, RobotDescription
from deltaq_protocol import topics
from deltaq_protocol.guarded import Command, CommandReply, RobotMemory
from deltaq_protocol.messages import MOST_COUNTED_ON
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.outputs import ToTopic
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

    @property
    def parts(self) -> tuple[object, ...]:
        """The objects that change."""
        return self, self.tracker, self.tracker.history, self.orders, self.inbox

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
        )

    def restore(self, memory: RobotMemory) -> None:
        """Restore another gate's snapshot of this robot."""
        self.tracker.restore(memory.tracker)
        self.orders.restore(memory.orders)
        self.inbox.waiting, self.inbox.decided = memory.waiting, memory.decided
        self.inbox.decided_cycle, self.inbox.spoken_cycle = memory.decided_cycle, memory.spoken_cycle
        self.inbox.lease_epoch, self.inbox.seq = memory.lease_epoch, memory.seq
        self.dry_run_cycle = memory.dry_run_cycle


def reply(id_: int, code: ReasonCode | None = None, message: str = "") -> ToTopic:
    """The reply to a command: taken or, with a code, why not."""
    answer = CommandReply(id=id_, accepted=code is None, code=code, message=message)
    return ToTopic(topics.COMMAND_REPLY, "", answer)
