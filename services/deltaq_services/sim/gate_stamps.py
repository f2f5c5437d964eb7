"""Stamps of the gate, taken only if the environment asks for them; see `deltaq_protocol.stamps`."""

from __future__ import annotations

import time
from collections.abc import Sequence

from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, Request
from deltaq_protocol.messages import Message, Outcome, Verdict
from deltaq_protocol.stamps import Stamps, StampStation
from deltaq_services.sim.core import Decider, Sim
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.tracker import Tracker


class GateStamps:
    """Stamps requests as they come, the begin and the end of each decision, and admissions as they go.

    Args:
        stamps: where to.
        sim: the SIM whose gate is watched; its decisions do not change.
    """

    def __init__(self, stamps: Stamps, sim: Sim) -> None:
        self._stamps = stamps
        self._watched = sim.gate = _Watched(sim.gate)

    def came(self, message: Message) -> None:
        """The gate is about to take a message."""
        if isinstance(message, Request) and message.dq is not None:
            self._stamps.add(StampStation.REQUEST_AT_GATE, message.robot, message.cycle, message.seq)

    def went(self, message: Message) -> None:
        """A message of the gate has been published: of a decision first the admission, if any, then the verdict."""
        if isinstance(message, Admission):
            self._stamps.add(StampStation.ADMISSION_OUT, message.robot, message.cycle)
        elif isinstance(message, Verdict) and message.outcome is not Outcome.REFUSED:
            robot, cycle, seq, watched = message.robot, message.cycle, message.seq, self._watched
            self._stamps.add(StampStation.DECISION_BEGUN, robot, cycle, seq, watched.begun_ns)
            self._stamps.add(StampStation.DECIDED, robot, cycle, seq, watched.decided_ns)


class _Watched:
    """A gate, and when its last decision began and ended [ns]."""

    def __init__(self, gate: Decider) -> None:
        self._gate = gate
        self.begun_ns = self.decided_ns = 0

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        self.begun_ns = time.monotonic_ns()
        decision = self._gate.decide(robot, others, request)
        self.decided_ns = time.monotonic_ns()
        return decision
