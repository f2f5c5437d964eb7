"""The gate's state of one robot: its motion, its orders, and the requests for it."""

from __future__ import annotations

import math

from deltaq_cell.description import GateDescription, RobotDescription
from deltaq_protocol import topics
from deltaq_protocol.guarded import RobotMemory
from deltaq_services.sim.inbox import Inbox
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import drives_of

_GAP = 4
"""Times that a Robot Server may be without a gate before it holds: orders that are under way arrive later."""


class GatedRobot:
    """One robot as the gate knows it.

    Attributes:
        name: of the robot.
        joints: how many it has.
        max_age_cycles: a command that goes by an older state is stale.
        tracker: its motion.
        orders: stop, reset and outputs.
        inbox: the requests for it.
        longest_gap_cycles: cycles that may be missed while it may move; a Robot Server that hears no gate holds it
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
