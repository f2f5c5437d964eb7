"""The motion of one robot from cycle to cycle, computed alike, bit for bit, by Robot Server and gate.

A gate that decides a few cycles ahead must know which setpoints the Robot Server will have sent by then.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import Admission, Plan, ServerState


@dataclass(frozen=True, slots=True, eq=False)
class SetpointMotion:
    """The setpoint that a robot was sent in a cycle, and the brake that follows without an admission.

    Attributes:
        q_cmd: (n,) setpoint [rad or m].
        dq: (n,) its increment [rad or m].
        plan_dq: (n,) increment that was admitted last [rad or m].
        brake_cycles: length of the brake that follows it.
        step: of that brake, as sent last; 0 is `plan_dq` itself.
        sequence: number of its admission; 0 if there is none.
    """

    q_cmd: Array
    dq: Array
    plan_dq: Array
    brake_cycles: int
    step: int
    sequence: int

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SetpointMotion) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(self._values())

    def _values(self) -> tuple[object, ...]:
        joints = (tuple(self.q_cmd.tolist()), tuple(self.dq.tolist()), tuple(self.plan_dq.tolist()))
        return (*joints, self.brake_cycles, self.step, self.sequence)

    @classmethod
    def at_rest(cls, q: Array, sequence: int = 0) -> Self:
        """A robot at rest at `q` (n,)."""
        zero = np.zeros_like(q)
        return cls(q, zero, zero, 1, 1, sequence)

    @classmethod
    def of(cls, state: ServerState) -> Self:
        """That of a robot in a state."""
        plan = state.plan
        q_cmd, dq, plan_dq = np.array(state.q_cmd), np.array(state.dq), np.array(plan.dq)
        return cls(q_cmd, dq, plan_dq, plan.brake_cycles, plan.step, state.sequence)

    @property
    def plan(self) -> Plan:
        """The admitted increment and its brake, as a message."""
        return Plan(dq=tuple(self.plan_dq.tolist()), brake_cycles=self.brake_cycles, step=self.step)

    @property
    def rests(self) -> bool:
        """Whether the brake has ended."""
        return self.step >= self.brake_cycles

    def brake(self) -> Array:
        """(n,) increment of the next cycle if nothing is admitted for it [rad or m]."""
        return brake_increment(self.plan_dq, self.brake_cycles, self.step + 1)

    def braked(self) -> Self:
        """A cycle later, nothing admitted for it."""
        return self.sent(self.plan_dq, self.brake_cycles, self.step + 1, self.sequence)

    def admitted(self, admission: Admission) -> Self:
        """A cycle later, by an admission."""
        return self.sent(np.array(admission.dq), admission.brake_cycles, 0, admission.sequence)

    def leads_to(self, admission: Admission) -> bool:
        """Whether an admission was decided on this motion."""
        follows = (admission.follows_sequence, admission.follows_q_cmd, admission.follows_dq)
        return follows == (self.sequence, tuple(self.q_cmd.tolist()), tuple(self.dq.tolist()))

    def sent(self, plan_dq: Array, brake_cycles: int, step: int, sequence: int) -> Self:
        """A cycle later, by a step of the brake after `plan_dq` (n,); step 0 is that increment itself."""
        dq = brake_increment(plan_dq, brake_cycles, step)
        q_cmd = self.q_cmd + dq
        if step >= brake_cycles:
            plan_dq, brake_cycles, step = np.zeros_like(q_cmd), 1, 1
        return type(self)(q_cmd, dq, plan_dq, brake_cycles, step, sequence)
