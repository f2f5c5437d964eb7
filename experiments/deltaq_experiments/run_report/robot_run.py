"""What one robot did in a recording: its way, its cycles, its phases, and the gate's verdicts on it."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import ServerState
from deltaq_protocol.messages import Outcome, Phase, Reason, RobotState, RobotSummary, Verdict
from deltaq_protocol.reasons import ReasonCode

ORDINARY_COUNTERS = frozenset({"admissions", "braked_cycles", "braked_cycles_no_admission"})
"""Counters of a Robot Server that grow while nothing is wrong."""


@dataclass
class ReasonGroup:
    """Verdicts with the same outcome, whose first reason has the same code.

    Attributes:
        outcome: scaled, held or refused.
        code: of the first reason; None where the verdict gave none.
        count: of the verdicts.
        first_s: time of the first one [s].
        last_s: time of the last one [s].
        limits: how often each limit was named, e.g. a joint or two bodies.
    """

    outcome: Outcome
    code: ReasonCode | None
    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    limits: Counter[str] = field(default_factory=Counter)

    def add(self, time_s: float, reason: Reason | None) -> None:
        """Count one more verdict."""
        if not self.count:
            self.first_s = time_s
        self.count += 1
        self.last_s = time_s
        if reason is not None and reason.what:
            self.limits[reason.what] += 1


class RobotRun:
    """One robot of a recording.

    Args:
        name: of the robot.
        summary: its joints and their limits.

    Attributes:
        phases: (time [s], phase, reason) whenever one of the two changed.
        missed_cycles: cycle numbers that no state had.
        restarts: how often cycles began anew.
        outcomes: verdicts by outcome.
        bound_s: times of the verdicts that did not admit as requested [s].
        reasons: those verdicts by outcome and reason.
        counters: increase of each counter of its Robot Server.
        least_clearance: least clearance of a verdict [m], its pair and time [s]; None if no verdict had one.
    """

    def __init__(self, name: str, summary: RobotSummary) -> None:
        self.name, self.summary = name, summary
        self.phases: list[tuple[float, Phase, ReasonCode | None]] = []
        self.missed_cycles = 0
        self.restarts = 0
        self.outcomes: Counter[Outcome] = Counter()
        self.bound_s: list[float] = []
        self.reasons: dict[tuple[Outcome, ReasonCode | None], ReasonGroup] = {}
        self.counters: Counter[str] = Counter()
        self.least_clearance: tuple[float, tuple[str, str] | None, float] | None = None
        self._time_s, self._q = array("d"), array("d")
        self._clearance = array("d")
        self._fastest = np.zeros(len(summary.joints))
        self._last: RobotState | None = None
        self._last_server: ServerState | None = None
        self._driven_cycles = self._cycles_since = 0

    def add_state(self, state: RobotState, time_s: float, cycle_s: float) -> None:
        """One cycle."""
        before = self._last
        if before is None or (before.phase, before.reason) != (state.phase, state.reason):
            self.phases.append((time_s, state.phase, state.reason))
        if before is not None:
            steps = state.cycle - before.cycle
            self.restarts += steps <= 0
            self.missed_cycles += max(steps - 1, 0)
            if steps == 1:
                speed = np.abs(np.subtract(state.q_cmd, before.q_cmd)) / cycle_s
                self._fastest = np.maximum(self._fastest, speed)
        self._time_s.append(time_s)
        self._q.extend(state.q)
        self._last = state

    def add_verdict(self, verdict: Verdict, time_s: float) -> None:
        """One decision of the gate, or a refusal before it."""
        self.outcomes[verdict.outcome] += 1
        if verdict.clearance_m is not None:
            self._clearance.extend((time_s, verdict.clearance_m))
            if self.least_clearance is None or verdict.clearance_m < self.least_clearance[0]:
                self.least_clearance = verdict.clearance_m, verdict.pair, time_s
        if verdict.outcome is Outcome.ADMITTED:
            return
        self.bound_s.append(time_s)
        reason = verdict.reasons[0] if verdict.reasons else None
        code = None if reason is None else reason.code
        group = self.reasons.setdefault((verdict.outcome, code), ReasonGroup(verdict.outcome, code))
        group.add(time_s, reason)

    def add_server_state(self, state: ServerState) -> dict[str, int]:
        """One cycle of the Robot Server; returns how much each extraordinary counter grew."""
        before, self._last_server = self._last_server, state
        if before is None or before.process != state.process:
            return {}
        self._cycles_since += max(state.cycle - before.cycle, 0)
        grown = {
            name: count - before.counters.get(name, 0)
            for name, count in state.counters.items()
            if count > before.counters.get(name, 0)
        }
        if "admissions" in grown:
            # before the first nobody drove it, and after the last nobody does
            self._driven_cycles += self._cycles_since if self.counters["admissions"] else grown["admissions"]
            self._cycles_since = 0
        self.counters.update(grown)
        return {name: count for name, count in grown.items() if name not in ORDINARY_COUNTERS}

    @property
    def time_s(self) -> Array:
        """(k,) times of the states [s]."""
        return np.array(self._time_s)

    @property
    def q(self) -> Array:
        """(k, n) measured joints [rad or m]."""
        return np.array(self._q).reshape(-1, len(self.summary.joints))

    @property
    def clearance(self) -> Array:
        """(k, 2) time [s] and clearance [m] of the verdicts that had one."""
        return np.array(self._clearance).reshape(-1, 2)

    @property
    def fastest(self) -> Array:
        """(n,) greatest commanded speed of each joint as a share of its limit."""
        return np.divide(self._fastest, self.summary.max_velocity)

    @property
    def admission_rate(self) -> float | None:
        """Share of the cycles in which a fresh, admitted increment reached the robot, from the first to the last.

        None without any.
        """
        return self.counters["admissions"] / self._driven_cycles if self._driven_cycles else None

    @property
    def intervals_s(self) -> tuple[float, float, float] | None:
        """Median, 99th percentile and longest time between two states [s]; None with fewer than two."""
        if len(self._time_s) < 2:
            return None
        steps = np.diff(self.time_s)
        return float(np.median(steps)), float(np.quantile(steps, 0.99)), float(steps.max())
