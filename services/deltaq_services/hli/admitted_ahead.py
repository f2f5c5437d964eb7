"""The setpoints to come, as far as the gate's verdicts tell them, in a cell with a lookahead.

Clients are told them so that they know what their next increment is added to. No robot is kept safe by them: the gate
has its own account.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from deltaq_protocol.guarded import ServerState
from deltaq_protocol.messages import Outcome, Verdict
from deltaq_protocol.setpoint_motion import SetpointMotion


@dataclass(frozen=True, slots=True)
class AheadMemory:
    """Snapshot of an `AdmittedAhead`.

    Attributes:
        verdicts: of each cycle to come, the verdict on what goes into it.
        decided: cycle of the setpoint that was decided last, held ones too.
        chain_cycle: cycle of the state since which the chain has not broken.
    """

    verdicts: Mapping[int, Verdict] = field(default_factory=dict)
    decided: int = -1
    chain_cycle: int = 0


class AdmittedAhead:
    """What one robot will be sent if it takes all that has been admitted.

    Args:
        cycles: how many setpoints may be decided that are not sent yet.
        cycle_s: sample time of the robot.
    """

    def __init__(self, cycles: int, cycle_s: float) -> None:
        self.cycles = cycles
        self._cycle_s = cycle_s
        self._verdicts: dict[int, Verdict] = {}
        self._decided, self._chain_cycle = -1, 0

    def decided(self, verdict: Verdict, state: ServerState) -> None:
        """The gate has decided an increment; `state` is the newest."""
        if verdict.cycle < self._chain_cycle:
            return  # of a chain that broke
        if verdict.setpoint_cycle is not None:
            self._verdicts[verdict.setpoint_cycle] = verdict
            self._decided = max(self._decided, verdict.setpoint_cycle)
        elif verdict.outcome is Outcome.HELD:
            self._decided = self.setpoint_cycle(state)  # for the brake

    def cycle_passed(self, state: ServerState) -> None:
        """A cycle has passed. If its admission was not taken, no later one will be: they follow it."""
        last = state.cycle + self.cycles
        if self._decided > last:  # another process counts from one
            self.restore(AheadMemory())
        due = self._verdicts.get(state.cycle)
        if due is not None and due.dq != state.dq:
            # as the gate does: what follows is given all the time there is
            self.restore(AheadMemory(decided=last - 1, chain_cycle=state.cycle))
        self._verdicts = {cycle: verdict for cycle, verdict in self._verdicts.items() if cycle >= state.cycle}

    def setpoint_cycle(self, state: ServerState) -> int:
        """The cycle that the next increment goes into, as the gate decides it."""
        if self._decided >= state.cycle:
            return min(self._decided + 1, state.cycle + self.cycles)
        rests = state.plan.step >= state.plan.brake_cycles
        return state.cycle + (self.cycles if rests else 1)

    def q_ahead(self, state: ServerState) -> tuple[float, ...]:
        """(n,) setpoint of the last cycle before that [rad or m]."""
        motion = SetpointMotion.of(state)
        for cycle in range(state.cycle + 1, self.setpoint_cycle(state)):
            verdict = self._verdicts.get(cycle)
            if verdict is None or verdict.time_to_stop_s is None:
                motion = motion.braked()
            else:
                brake_cycles = max(1, round(verdict.time_to_stop_s / self._cycle_s))
                motion = motion.sent(np.array(verdict.dq), brake_cycles, 0, state.sequence)
        return tuple(motion.q_cmd.tolist())

    def snapshot(self) -> AheadMemory:
        """Snapshot for `restore`."""
        return AheadMemory(dict(self._verdicts), self._decided, self._chain_cycle)

    def restore(self, memory: AheadMemory) -> None:
        """Go on from where another was."""
        self._verdicts = dict(memory.verdicts)
        self._decided, self._chain_cycle = memory.decided, memory.chain_cycle
