"""The setpoints to come, as far as the gate's verdicts tell them, in a cell with a lookahead.

Clients are told them so that they know what their next increment is added to. No robot is kept safe by them: the gate
has its own account.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deltaq_protocol.guarded import ServerState
from deltaq_protocol.messages import Verdict
from deltaq_protocol.setpoint_motion import SetpointMotion


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

    def decided(self, verdict: Verdict) -> None:
        """The gate has decided an increment."""
        if verdict.setpoint_cycle is not None:
            self._verdicts[verdict.setpoint_cycle] = verdict

    def cycle_passed(self, state: ServerState) -> None:
        """A cycle has passed. If its admission was not taken, no later one will be: they follow it."""
        due = self._verdicts.get(state.cycle)
        broken = due is not None and due.dq != state.dq
        last = state.cycle + self.cycles
        self._verdicts = {
            cycle: verdict
            for cycle, verdict in self._verdicts.items()
            if state.cycle <= cycle <= last and not broken
        }

    def setpoint_cycle(self, state: ServerState) -> int:
        """The cycle that the next increment goes into, as the gate decides it."""
        if self._verdicts:
            return min(max(self._verdicts) + 1, state.cycle + self.cycles)
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

    def snapshot(self) -> Mapping[int, Verdict]:
        """Snapshot for `restore`."""
        return dict(self._verdicts)

    def restore(self, verdicts: Mapping[int, Verdict]) -> None:
        """Go on from where another was."""
        self._verdicts = dict(verdicts)
