"""What is heard of one robot, and what a frame shows of it. Pure: whoever has a clock says when things came."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_travel
from deltaq_protocol.messages import Outcome, Phase, RobotState, Vector3, Verdict
from deltaq_services.console.frame import NO_BODY, RobotFrame

WINDOW_S = 1.0
"""Time over which rates are taken."""
STALE_S = 0.25
"""A state that is older is shown as stale: twenty cycles of 12 ms."""
VERDICT_S = 0.5
"""A verdict that is older is no longer shown: nobody drives."""

CREEP = 0.001
"""Fraction of the joints' speed limits below which axes count as still: sensors are not without noise."""


class RobotFeed:
    """One robot, as heard.

    Args:
        robot: its description.
        cycle_s: its cycle [s].
        bodies: place of each body in the scene's list, by name.

    Attributes:
        state: the newest state, None before the first.
        verdict: the newest verdict, None before the first.
    """

    def __init__(self, robot: RobotDescription, cycle_s: float, bodies: Mapping[str, int]) -> None:
        self.state: RobotState | None = None
        self.verdict: Verdict | None = None
        self._home = robot.home
        self._max_dv = robot.max_acceleration * cycle_s**2
        self._creep = CREEP * robot.max_velocity * cycle_s
        self._bodies = bodies
        self._dq: Array = np.zeros(len(self._home))
        self._measured: Array = np.full(len(self._home), math.inf)
        self._state_s = self._verdict_s = -math.inf
        self._outcomes: deque[tuple[float, Outcome]] = deque()
        self._gaps: deque[tuple[float, float]] = deque()

    def arrived(self, gap_s: float, now_s: float) -> None:
        """The longest time between two states since this was said last was `gap_s` [s]."""
        self._gaps.append((now_s, gap_s))

    def take_state(self, state: RobotState, arrived_s: float) -> bool:
        """A newer state has come; returns whether it is one of this robot."""
        if len(state.q) != len(self._home) or len(state.q_cmd) != len(self._home):
            return False
        before = self.state
        if before is not None and state.cycle > before.cycle:
            cycles = state.cycle - before.cycle
            self._dq = np.subtract(state.q_cmd, before.q_cmd) / cycles
            self._measured = np.subtract(state.q, before.q) / cycles
        self.state, self._state_s = state, arrived_s
        return True

    def take_verdict(self, verdict: Verdict, arrived_s: float) -> None:
        """A verdict on this robot has come."""
        self.verdict, self._verdict_s = verdict, arrived_s
        self._outcomes.append((arrived_s, verdict.outcome))

    def is_stale(self, now_s: float) -> bool:
        """Whether the newest state is too old to be acted upon."""
        return now_s - self._state_s > STALE_S

    def frame(self, now_s: float, focus: Vector3 | None) -> RobotFrame:
        """What a frame shows at `now_s`.

        Args:
            now_s: time [s].
            focus: what its camera looks at, in the world [m].
        """
        for waiting in (self._outcomes, self._gaps):
            while waiting and waiting[0][0] < now_s - WINDOW_S:
                waiting.popleft()
        verdict = self.verdict if now_s - self._verdict_s <= VERDICT_S else None
        state = self.state
        stale = self.is_stale(now_s)
        phase = Phase.OFFLINE if state is None else state.phase
        admitted = [outcome is Outcome.ADMITTED for _, outcome in self._outcomes]
        gaps = [gap for _, gap in self._gaps]
        if math.isfinite(self._state_s):
            gaps.append(now_s - self._state_s)
        return RobotFrame(
            phase=phase,
            outcome=None if verdict is None else verdict.outcome,
            is_stale=stale,
            is_braking=phase is Phase.BRAKING or (phase is Phase.HELD and bool(self._dq.any())),
            age_s=now_s - self._state_s,
            clearance_m=math.nan if verdict is None or verdict.clearance_m is None else verdict.clearance_m,
            pair=self._places(None if verdict is None else verdict.pair),
            admission=sum(admitted) / len(admitted) if admitted else math.nan,
            longest_cycle_s=max(gaps, default=math.nan),
            focus=focus,
            q=self._home if state is None else np.array(state.q),
            q_rest=self._rest(state),
        )

    @property
    def is_still(self) -> bool:
        """Whether the setpoint stands still and the axes do not follow it any more, as the two newest states say."""
        return bool((self._dq == 0.0).all() and (np.abs(self._measured) < self._creep).all())

    def _rest(self, state: RobotState | None) -> Array:
        """Where the brake that follows the last increment would end."""
        if state is None:
            return self._home
        cycles = brake_cycles(self._dq, self._max_dv)
        rest: Array = np.array(state.q_cmd) + brake_travel(self._dq, cycles, 0)
        return rest

    def _places(self, pair: tuple[str, str] | None) -> tuple[int, int]:
        a, b = pair or ("", "")
        return self._bodies.get(a, NO_BODY), self._bodies.get(b, NO_BODY)
