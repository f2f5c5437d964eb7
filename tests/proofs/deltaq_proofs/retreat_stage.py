"""Robots, their setpoints and the gate, and nothing else: what is admitted is driven, and the drives follow at once."""

from __future__ import annotations

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_proofs.retreat_situations import Situation
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import Admission, Plan, ServerState
from deltaq_protocol.messages import Outcome, Phase
from deltaq_services.sim.gate import Contacts, Gate
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.retreat import Violations
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import drives_of


class Stage:
    """Where one situation is played.

    Args:
        cell: its cell.
        proximity: of that cell.
        drawn: the situation.

    Attributes:
        longest_brake: cycles after which every robot that is asked for nothing more stands.
    """

    def __init__(self, cell: CellModel, proximity: CompiledProximity, drawn: Situation) -> None:
        description = cell.description
        cycle_s = description.cycle_s
        self._limits = {name: Limits.of(robot, cycle_s) for name, robot in description.robots.items()}
        self._gate = Gate(
            proximity, self._limits, description.gate, Contacts(proximity, description.contacts), Violations()
        )
        drives = {
            name: drives_of(robot, description.gate, cycle_s) for name, robot in description.robots.items()
        }
        self._trackers = {
            name: Tracker(name, robot, drives[name], cycle_s) for name, robot in description.robots.items()
        }
        self._plans: dict[str, Plan] = {}
        lag = 1 + max(each.lag for each in drives.values())
        self._cycle, self._sequence = lag, 0
        for name, tracker in self._trackers.items():
            dq = drawn.dq[name]
            self._plans[name] = self._plan(name, dq, 0 if dq.any() else 1)
            for cycle in range(1, lag + 1):
                tracker.observe(self._state(name, cycle, drawn.q[name] - (lag - cycle) * dq, dq))
        self.longest_brake = lag + max(
            self._plan(name, limits.max_dq, 0).brake_cycles for name, limits in self._limits.items()
        )

    def q_cmd(self) -> dict[str, Array]:
        """Per robot its setpoint (n,) [rad or m]."""
        return {name: tracker.q_cmd for name, tracker in self._trackers.items()}

    def fastest(self, robot: str) -> Array:
        """(n,) increment of each joint at its velocity limit [rad or m]."""
        return self._limits[robot].max_dq

    def ask(self, robot: str, dq: Array) -> Outcome:
        """Ask for an increment (n,) [rad or m]; what is admitted is sent in the next cycle."""
        tracker = self._trackers[robot]
        others = [other for name, other in self._trackers.items() if name != robot]
        decision = self._gate.decide(tracker, others, dq)
        state = tracker.state
        assert state is not None  # every robot has been heard
        if decision.outcome is not Outcome.HELD:
            self._sequence += 1
            ahead = tracker.ahead
            admission = Admission(
                robot=robot,
                epoch=1,
                sequence=self._sequence,
                cycle=tracker.decided_after,
                follows_sequence=ahead.sequence,
                follows_q_cmd=tuple(ahead.q_cmd.tolist()),
                follows_dq=tuple(ahead.dq.tolist()),
                dq=tuple(decision.dq.tolist()),
                brake_cycles=decision.brake_cycles,
            )
            tracker.admitted(admission)
        return decision.outcome

    def cycle(self) -> None:
        """Send every robot its admitted increment, or the next step of its brake."""
        self._cycle += 1
        for name, tracker in self._trackers.items():
            plan = self._plans[name]
            if tracker.in_flight:
                admitted = tracker.in_flight[0]
                plan = Plan(dq=admitted.dq, brake_cycles=admitted.brake_cycles, step=0)
            else:
                plan = plan.model_copy(update={"step": plan.step + 1})
            dq = brake_increment(np.array(plan.dq), plan.brake_cycles, plan.step)
            self._plans[name] = (
                plan if plan.step < plan.brake_cycles else self._plan(name, np.zeros_like(dq), 1)
            )
            tracker.observe(self._state(name, self._cycle, tracker.q_cmd + dq, dq))

    def _plan(self, robot: str, dq: Array, step: int) -> Plan:
        return Plan(dq=tuple(dq.tolist()), brake_cycles=self._limits[robot].brake_cycles(dq), step=step)

    def _state(self, robot: str, cycle: int, q: Array, dq: Array) -> ServerState:
        here = tuple(q.tolist())
        return ServerState(
            robot=robot,
            process=1,
            cycle=cycle,
            ipoc=cycle,
            time_s=float(cycle),
            q=here,
            q_cmd=here,
            dq=tuple(dq.tolist()),
            plan=self._plans[robot],
            epoch=1,
            sequence=self._sequence,
            phase=Phase.ENGAGED,
        )
